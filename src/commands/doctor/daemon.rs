//! Reports what the control socket of the daemon tells: why the source is down, which receivers of datagrams fail, and
//! the doubts. Without it, the monitor tells of the source.

use std::net::SocketAddr;
use std::time::Duration;

use serde_json::Value;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;
use trifacet::client::Endpoint;
use trifacet::config::Config;
use trifacet::control::{self, Command};

use super::Report;
use crate::commands::status::drift;

/// Longest time to wait for the control socket, or for the monitor.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);

/// Reports a source that is down, receivers that fail, and the doubts that stand. Without a control socket, the monitor
/// of a daemon on this machine tells of the source, and nothing is known of receivers and doubts.
pub(super) async fn look(endpoint: &Endpoint, config: &Config, report: &mut Report) {
    let Some(socket) = config.control.socket.clone().filter(|socket| socket.exists()) else {
        return source(endpoint, config, report).await;
    };
    let name = socket.display().to_string();
    let asked = tokio::task::spawn_blocking(move || control::client::ask(&socket, &Command::Status));
    let status = match timeout(ANSWER_TIMEOUT, asked).await {
        Ok(Ok(Ok(status))) => status,
        Ok(Ok(Err(error))) => return unknown(&error.message, report),
        Ok(Err(_)) | Err(_) => return unknown(&format!("{name} does not answer"), report),
    };
    if let Some(why) = status["source"]["down"].as_str() {
        report.wrong(&format!("the source is down: {why}"), "");
    }
    let receivers = status["receivers"].as_array().map(Vec::as_slice).unwrap_or_default();
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let failing: Vec<_> = receivers.iter().filter(|receiver| !receiver["failing"].is_null()).collect();
    if failing.is_empty() && !receivers.is_empty() {
        report.good(&format!("datagrams leave for {} receivers", receivers.len()));
    }
    for receiver in failing {
        let [since, cause] = ["since", "cause"].map(|key| text(&receiver["failing"][key]));
        let (kind, name) = (text(&receiver["kind"]), text(&receiver["receiver"]));
        let what = format!("no datagrams reach the {kind} {name} since {since}: {cause}");
        report.note(&what, "the daemon keeps trying; other receivers are not affected");
    }
    let doubts = status["doubts"].as_array().map(Vec::as_slice).unwrap_or_default();
    let drifted = doubts.iter().any(|doubt| doubt["subject"] == "calibration_drift");
    if let Some(drift) = drift(&status).filter(|_| !drifted) {
        report.good(&format!("the steering residual is that of the calibration: {drift}"));
    }
    for doubt in doubts {
        let [since, text] = ["since", "text"].map(|key| doubt[key].as_str().unwrap_or_default());
        report.note(&format!("doubt since {since}: {text}"), "it stands until its cause is removed");
    }
}

/// Reports a source that is down, as the monitor of this machine tells. It may be that of another daemon, unless the
/// stream comes from this machine too.
async fn source(endpoint: &Endpoint, config: &Config, report: &mut Report) {
    let Endpoint::Tcp(place) = endpoint else { return };
    let here = ["127.", "localhost:", "[::1]"].iter().any(|start| place.starts_with(start));
    let Some(monitor) = config.monitor.listen.filter(|_| here) else { return };
    let Ok(Some(ready)) = timeout(ANSWER_TIMEOUT, readiness(monitor)).await else { return };
    let checks = ready["checks"].as_array().into_iter().flatten();
    let mut reasons = checks.filter(|check| check["name"] == "samples").filter_map(|c| c["reason"].as_str());
    if let Some(why) = reasons.find_map(|reason| reason.strip_prefix("SOURCE_DOWN: ")) {
        report.wrong(&format!("the source is down: {why}"), "");
    }
}

/// The answer of `/readyz`, if there is one.
async fn readiness(monitor: SocketAddr) -> Option<Value> {
    let mut stream = TcpStream::connect(monitor).await.ok()?;
    stream.write_all(b"GET /readyz HTTP/1.0\r\n\r\n").await.ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).await.ok()?;
    serde_json::from_str(answer.split_once("\r\n\r\n")?.1).ok()
}

fn unknown(why: &str, report: &mut Report) {
    report.note(
        &format!(
            "the state of the source, of the receivers of datagrams and of the doubts is not known: {why}"
        ),
        "run doctor as a user who may use the control socket ([control] mode)",
    );
}
