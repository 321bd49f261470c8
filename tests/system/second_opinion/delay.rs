//! The delay of commands, measured by the ids that the scans state.

use serde_json::Value;

use super::board::{Board, Program};
use crate::testkit::http::get;
use crate::testkit::{Daemon, run, trifacet};

/// Delay of the line to the board, milliseconds: more than a loop with the default `loop_delay_ms` can bear.
const LINE_MS: f64 = 8.0;

/// The state of the commands as soon as their delay is known.
fn measured(daemon: &mut Daemon) -> Value {
    daemon.client().samples(1);
    daemon.status_until(|status| status["loop"]["commands"]["delay_ms"].is_number())["loop"]["commands"]
        .clone()
}

/// The doubt about the loop delay in a status; null without one.
fn doubt(status: &Value) -> Value {
    let all = status["doubts"].as_array().unwrap();
    all.iter().find(|doubt| doubt["subject"] == "loop_delay").cloned().unwrap_or_default()
}

#[test]
fn a_delay_beyond_the_margins_of_the_loop_is_measured_and_doubted() {
    let program = Program::board();
    let board = Board::start(&program, &format!("line_ms={LINE_MS}"));
    let mut daemon = board.daemon("monitor.listen = \"127.0.0.1:0\"");
    let commands = measured(&mut daemon);
    assert!(commands["delay_ms"].as_f64().unwrap() >= LINE_MS, "{commands}");
    assert_eq!(commands["loop_delay_ms"], 2.5);
    let status = daemon.status_until(|status| !doubt(status).is_null());
    let doubt = doubt(&status)["text"].as_str().unwrap().to_owned();
    assert!(doubt.contains("2.5 ms") && doubt.contains("trifacet tune"), "{doubt}");
    daemon.says("a warning", |line| {
        line["level"] == "WARN" && line["message"].as_str().is_some_and(|text| text.contains("trifacet tune"))
    });
    let page = get(daemon.monitor(), "/metrics").body;
    let metric = |name: &str| -> f64 {
        let line = page.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
        line.unwrap_or_else(|| panic!("{page}")).trim().parse().unwrap()
    };
    assert!(metric("trifacet_command_delay_seconds") >= LINE_MS * 1e-3);
    assert_eq!(metric("trifacet_loop_delay_seconds"), 2.5e-3);
    let endpoint = format!("tcp://{}", daemon.address());
    let shown = run(trifacet(&["status", &endpoint, "--socket"]).arg(daemon.socket()));
    let words = shown.out.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words.contains("doubt since") && words.contains("trifacet tune"), "{}", shown.out);
}

#[test]
fn a_delay_that_is_configured_is_not_doubted_and_version_1_0_measures_none() {
    let program = Program::board();
    let board = Board::start(&program, &format!("line_ms={LINE_MS}"));
    let mut daemon = board.daemon("centering.loop_delay_ms = 100");
    let commands = measured(&mut daemon);
    assert!(commands["delay_ms"].as_f64().unwrap() >= LINE_MS, "{commands}");
    assert_eq!(doubt(&daemon.status()), Value::Null);
    let board = Board::start(&program, "minor=0");
    let mut daemon = board.daemon("");
    let mut client = daemon.client();
    client.locked();
    client.samples(500);
    let status = daemon.status_until(|status| status["loop"]["lock"] == "locked");
    assert!(status["loop"]["commands"]["delay_ms"].is_null() && doubt(&status).is_null(), "{status}");
}
