//! Boards that do not acknowledge steering commands.

use serde_json::Value;
use trifacet_wire::LockState;

use crate::testkit::http::get;
use crate::testkit::{Board, Daemon, Stream, run, trifacet};

const SILENT: &str = "the stage does not answer commands";
const ANSWERS: &str = "the stage answers commands again";

/// The value of a metric without labels.
fn metric(daemon: &mut Daemon, name: &str) -> f64 {
    let page = get(daemon.monitor(), "/metrics").body;
    let line = page
        .lines()
        .find_map(|line| line.strip_prefix(name)?.strip_prefix(' '))
        .unwrap_or_else(|| panic!("{page}"));
    line.trim().parse().unwrap()
}

/// The number of lines of the log with this message.
fn said(daemon: &Daemon, text: &str) -> usize {
    daemon.log.iter().filter(|line| line["message"] == text).count()
}

/// Orders a fault for this time, and waits until the loop holds. Returns the system time before the order.
fn held(board: &mut Board, stream: &mut Stream, order: &str, for_s: f64) -> i64 {
    stream.locked();
    let ordered_ns = board.order(&format!("{order} {for_s}"));
    let held = stream.until("held", |f| f.sent_ns() > ordered_ns && f.lock == LockState::Held);
    assert!(held.valid(), "the pose does not depend on the stage");
    ordered_ns
}

/// The loop must not be locked before the fault ends.
fn locks_after(stream: &mut Stream, ordered_ns: i64, for_s: f64) {
    let locked = stream.locked();
    let after_s = (locked.time_ns - ordered_ns) as f64 * 1e-9;
    assert!(after_s > for_s, "locked after {after_s} s");
}

#[test]
fn commands_without_an_answer_are_reported_and_the_loop_holds_until_they_are_answered_again() {
    let mut board = Board::start("");
    let mut daemon = Daemon::on_port(&board.link(), "monitor.listen = \"127.0.0.1:0\"");
    let mut stream = daemon.client();
    let ordered_ns = held(&mut board, &mut stream, "mute-acks", 8.0);
    daemon.message(SILENT);
    let cause = |line: &Value| line["message"] == "lock" && line["cause"] == SILENT;
    daemon.says("the cause of the change of the lock state", cause);
    let status = daemon.status_until(|status| status["loop"]["commands"]["age_s"].as_f64().unwrap() > 0.3);
    let commands = &status["loop"]["commands"];
    assert!(commands["overdue"] == true && commands["unanswered"].as_u64().unwrap() > 10, "{commands}");
    assert!(metric(&mut daemon, "trifacet_commands_unanswered") > 10.0);
    assert!(metric(&mut daemon, "trifacet_command_age_seconds") > 0.3);
    let endpoint = format!("tcp://{}", daemon.address());
    let shown = run(trifacet(&["status", &endpoint, "--socket"]).arg(daemon.socket()));
    let line = shown.out.lines().find(|line| line.starts_with("commands "));
    assert!(line.is_some_and(|line| line.contains("the stage does not answer")), "{}", shown.out);
    assert_eq!(board.status()["steering"], "commanded", "commands renew the lease all the same");
    locks_after(&mut stream, ordered_ns, 8.0);
    daemon.message(ANSWERS);
    let commands = daemon.status_until(|status| status["loop"]["commands"]["overdue"] == false);
    assert!(commands["loop"]["commands"]["age_s"].as_f64().unwrap() < 8.0, "{commands}");
    assert_eq!(commands["counters"]["acks_unknown"], 0);
    daemon.read_log();
    assert_eq!(said(&daemon, SILENT), said(&daemon, ANSWERS), "{:#?}", daemon.log);
}

#[test]
fn acknowledgements_of_other_commands_are_counted_and_do_not_count_as_answers() {
    let mut board = Board::start("");
    let mut daemon = Daemon::on_port(&board.link(), "");
    let mut stream = daemon.client();
    let ordered_ns = held(&mut board, &mut stream, "wrong-acks", 3.0);
    daemon.message(SILENT);
    locks_after(&mut stream, ordered_ns, 3.0);
    daemon.message(ANSWERS);
    assert!(stream.heartbeat().counters["acks_unknown"] > 10);
}

#[test]
fn a_twin_that_acknowledges_no_commands_is_held_from_the_start() {
    let mut daemon = Daemon::start("twin.fault = [{ at_s = 0.0, kind = \"mute-acks\" }]");
    let mut stream = daemon.client();
    daemon.message(SILENT);
    stream.skip_to_now();
    let frames = stream.samples(500);
    assert!(frames.iter().all(|f| f.valid() && !f.locked() && f.lock != LockState::Acquiring));
}
