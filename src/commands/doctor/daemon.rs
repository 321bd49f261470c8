//! Reports what the control socket of the daemon tells: why the source is down, which receivers of datagrams fail, and
//! the doubts.

use std::time::Duration;

use serde_json::Value;
use tokio::time::timeout;
use trifacet::config::Config;
use trifacet::control::{self, Command};

use super::Report;

/// Longest time to wait for the control socket.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);

/// Reports a source that is down, receivers that fail, and the doubts that stand. Without a control socket on this
/// machine, nothing is known of them.
pub(super) async fn look(config: &Config, report: &mut Report) {
    let Some(socket) = config.control.socket.clone().filter(|socket| socket.exists()) else { return };
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
    for doubt in status["doubts"].as_array().map(Vec::as_slice).unwrap_or_default() {
        let [since, text] = ["since", "text"].map(|key| doubt[key].as_str().unwrap_or_default());
        report.note(&format!("doubt since {since}: {text}"), "it stands until its cause is removed");
    }
}

fn unknown(why: &str, report: &mut Report) {
    report.note(
        &format!(
            "the state of the source, of the receivers of datagrams and of the doubts is not known: {why}"
        ),
        "run doctor as a user who may use the control socket ([control] mode)",
    );
}
