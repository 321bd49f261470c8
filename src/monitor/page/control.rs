//! `POST /control`: the few commands that the page may give, with the token.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::Mutex;

use super::own_page;
use crate::config::{LoopMode, MonitorConfig, Token};
use crate::control::{self, Command, Live};
use crate::monitor::view::View;
use crate::recording::Wish;

/// What a person with the token may do. There is none unless `monitor.control` is on.
#[derive(Clone, Debug)]
pub struct Controls {
    /// Who has it, may.
    pub token: Token,
    /// The daemon.
    pub live: Arc<Mutex<Live>>,
}

impl Controls {
    /// If the configuration allows it.
    pub fn of(config: &MonitorConfig, live: &Arc<Mutex<Live>>) -> Option<Self> {
        let token = config.token.clone().filter(|_| config.control)?;
        Some(Self { token, live: Arc::clone(live) })
    }
}

/// `{"command": "loop on"}`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Order {
    command: String,
}

/// Does what it says, if all is in order. As JSON it needs a header that no form of another site can set.
pub async fn obey(State(view): State<Arc<View>>, headers: HeaderMap, Json(order): Json<Order>) -> Response {
    let refuse = |code: StatusCode, why: &str| {
        view.sources.counters.monitor_forbidden.one();
        (code, Json(json!({ "error": why }))).into_response()
    };
    let Some(controls) = &view.sources.control else {
        return refuse(StatusCode::FORBIDDEN, "the page may only look: monitor.control is off");
    };
    if !own_page(&headers) {
        return refuse(StatusCode::FORBIDDEN, "the page of another server may not steer");
    }
    if !bearer(&headers).is_some_and(|given| controls.token.is(given)) {
        return refuse(StatusCode::UNAUTHORIZED, "wrong token: it is monitor.token of the configuration");
    }
    match order.command.parse() {
        Ok(command) if allowed(&command) => {
            let answer = controls.live.lock().await.obey(command).await;
            control::server::note(&command, None, &answer);
            Json(answer).into_response()
        }
        _ => {
            let why = "allowed are: tare, tare clear, loop on, loop off, loop shadow, park, record start, record stop";
            (StatusCode::BAD_REQUEST, Json(Value::from_iter([("error", why)]))).into_response()
        }
    }
}

fn bearer(headers: &HeaderMap) -> Option<&str> {
    headers.get(header::AUTHORIZATION)?.to_str().ok()?.strip_prefix("Bearer ")
}

/// Nothing that writes into the configuration, and nothing that needs numbers.
fn allowed(command: &Command) -> bool {
    matches!(
        command,
        Command::Tare { poses: None, save: false }
            | Command::ClearTare { save: false }
            | Command::Loop(LoopMode::On | LoopMode::Off | LoopMode::Shadow)
            | Command::Park
            | Command::Record(Wish::Start | Wish::Stop)
    )
}
