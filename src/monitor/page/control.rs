//! `POST /control`: the few commands that the page may give, with the token.

use std::net::SocketAddr;
use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::JsonRejection;
use axum::extract::{ConnectInfo, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::json;
use tokio::sync::Mutex;
use trifacet_core::centering::LoopMode;

use super::own_page;
use crate::config::{MonitorConfig, Token};
use crate::control::{self, Command, RunningConfig};
use crate::monitor::view::View;
use crate::recording::RecorderCommand;

/// What a person with the token may do. There is none unless `monitor.control` is on.
#[derive(Clone, Debug)]
pub struct Controls {
    /// Who has it, may.
    pub token: Token,
    /// The daemon.
    pub live: Arc<Mutex<RunningConfig>>,
}

impl Controls {
    /// If the configuration allows it.
    pub fn of(config: &MonitorConfig, live: &Arc<Mutex<RunningConfig>>) -> Option<Self> {
        let token = config.token.clone().filter(|_| config.control)?;
        Some(Self { token, live: Arc::clone(live) })
    }
}

/// `{"command": "loop on"}`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PageCommand {
    command: String,
}

/// Does what it says, if all is in order. As JSON it needs a header that no form of another site can set.
pub async fn obey(
    State(view): State<Arc<View>>,
    ConnectInfo(peer): ConnectInfo<SocketAddr>,
    headers: HeaderMap,
    order: Result<Json<PageCommand>, JsonRejection>,
) -> Response {
    let counters = &view.sources.counters;
    let Some(controls) = &view.sources.control else {
        counters.monitor_denied.inc();
        return refusal(StatusCode::FORBIDDEN, "the page may only look: monitor.control is off");
    };
    if !own_page(&headers) {
        counters.monitor_forbidden.inc();
        return refusal(StatusCode::FORBIDDEN, "the page of another server may not steer");
    }
    if !bearer(&headers).is_some_and(|given| controls.token.is(given)) {
        counters.monitor_denied.inc();
        // Who it was, and never what was given: that may be nearly right.
        tracing::warn!(%peer, "monitor: an order with a wrong token");
        return refusal(StatusCode::UNAUTHORIZED, "wrong token: it is monitor.token of the configuration");
    }
    let order = match order {
        Ok(Json(order)) => order,
        // To tell JSON of another form from no JSON helps nobody.
        Err(e) if e.status() == StatusCode::UNPROCESSABLE_ENTITY => {
            return refusal(StatusCode::BAD_REQUEST, &e.body_text());
        }
        Err(e) => return refusal(e.status(), &e.body_text()),
    };
    match order.command.parse() {
        Ok(command) if allowed(&command) => {
            let answer = controls.live.lock().await.obey(command).await;
            control::server::note(&command, None, &answer);
            Json(answer).into_response()
        }
        _ => {
            let why = "allowed are: tare, tare clear, loop on, loop off, loop shadow, park, record start, record stop";
            refusal(StatusCode::BAD_REQUEST, why)
        }
    }
}

/// As the page reads it.
pub fn refusal(code: StatusCode, why: &str) -> Response {
    (code, Json(json!({ "error": why }))).into_response()
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
            | Command::Record(RecorderCommand::Start | RecorderCommand::Stop)
    )
}
