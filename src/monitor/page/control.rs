//! `POST /control`: the commands that the page can give, with the token.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::{ConnectInfo, FromRequest, Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::json;
use tokio::time::timeout;
use trifacet_core::centering::LoopMode;

use crate::control::server::Sender;
use crate::control::{self, Command};
use crate::monitor::host_filter::own_page;
use crate::monitor::view::View;
use crate::recording::RecorderCommand;

/// Largest body of a request, bytes.
pub const LONGEST: usize = 4096;
/// Longest time until the body of a request has arrived.
const BODY_TIMEOUT: Duration = Duration::from_secs(5);

/// A command from the page: `{"command": "loop on"}`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PageCommand {
    command: String,
}

/// Executes a command if the request is authorized. Its content type must be JSON, which a form of another
/// site cannot send. Nothing of the body is read before the request is authorized.
pub async fn obey(
    State(view): State<Arc<View>>,
    ConnectInfo(peer): ConnectInfo<SocketAddr>,
    headers: HeaderMap,
    request: Request,
) -> Response {
    let counters = &view.sources.condition.counters;
    let Some(controls) = &view.sources.control else {
        counters.monitor_denied.inc();
        return refusal(StatusCode::FORBIDDEN, "the page cannot send commands: monitor.control is off");
    };
    if !own_page(&headers) {
        counters.monitor_forbidden.inc();
        return refusal(StatusCode::FORBIDDEN, "commands from the page of another server are refused");
    }
    if !bearer(&headers).is_some_and(|given| controls.token.is(given)) {
        counters.monitor_denied.inc();
        // The given token is not logged: it may be nearly right.
        tracing::warn!(%peer, "monitor: a command with a wrong token");
        return refusal(StatusCode::UNAUTHORIZED, "wrong token: use monitor.token of the configuration");
    }
    let order = match timeout(BODY_TIMEOUT, Json::<PageCommand>::from_request(request, &())).await {
        Ok(Ok(Json(order))) => order,
        // Clients need no distinction between invalid JSON and unexpected JSON.
        Ok(Err(e)) if e.status() == StatusCode::UNPROCESSABLE_ENTITY => {
            return refusal(StatusCode::BAD_REQUEST, &e.body_text());
        }
        Ok(Err(e)) => return refusal(e.status(), &e.body_text()),
        Err(_) => return refusal(StatusCode::REQUEST_TIMEOUT, "the request did not arrive within 5 s"),
    };
    match order.command.parse() {
        Ok(command) if allowed(&command) => {
            let answer = control::live::obey(&controls.live, command).await;
            control::server::note(&command, Sender::Page(peer), &answer);
            Json(answer).into_response()
        }
        _ => {
            let why =
                "allowed: tare, tare clear, loop on, loop off, loop shadow, park, record start, record stop";
            refusal(StatusCode::BAD_REQUEST, why)
        }
    }
}

/// A refusal in the format that the page reads.
pub fn refusal(code: StatusCode, why: &str) -> Response {
    (code, Json(json!({ "error": why }))).into_response()
}

fn bearer(headers: &HeaderMap) -> Option<&str> {
    headers.get(header::AUTHORIZATION)?.to_str().ok()?.strip_prefix("Bearer ")
}

/// Whether the page may give this command: none that writes to the configuration, none with numbers.
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
