//! `/healthz` and `/readyz`, and their changes.

use std::io::Write;
use std::net::SocketAddr;

use serde_json::Value;

use super::page::{nothing_stays_green, until};
use crate::testkit::http::get;
use crate::testkit::{Board, Daemon, Folder, now_ns};

const ON: &str = "monitor.listen = \"127.0.0.1:0\"\n";

fn check<'a>(ready: &'a Value, name: &str) -> &'a Value {
    ready["checks"].as_array().unwrap().iter().find(|check| check["name"] == name).unwrap()
}

fn since_ns(ready: &Value, name: &str) -> i64 {
    let since: jiff::Timestamp = check(ready, name)["since"].as_str().unwrap().parse().unwrap();
    since.as_nanosecond() as i64
}

/// Checks that the state changed within a second of the order, by the time stamps of the daemon. The change
/// may precede the order: samples that were due before it and are sent late already contain the fault.
fn within_a_second(ready: &Value, name: &str, ordered_ns: i64) {
    let late_ns = since_ns(ready, name) - ordered_ns;
    assert!(late_ns.abs() < 1_000_000_000, "{late_ns} ns: {ready}");
}

/// Orders a fault of 1 s and waits for its begin and its end.
fn comes_and_goes(at: SocketAddr, board: &mut Board, fault: &str, name: &str, reason: &str) {
    let ordered = board.order(&format!("{fault} 1"));
    let gone = until(at, fault, |ready| {
        check(ready, name)["reason"].as_str().is_some_and(|told| told.starts_with(reason))
    });
    within_a_second(&gone, name, ordered);
    let page = get(at, "/healthz");
    assert_eq!(
        (page.code, &page.body[..]),
        (200, "ok\n"),
        "the health of the daemon depends neither on the light nor on the board"
    );
    let back = until(at, "ready again", |ready| ready["ready"] == true);
    within_a_second(&back, name, ordered + 1_000_000_000);
}

#[test]
fn readiness_changes_within_a_second_and_states_the_reason() {
    let mut board = Board::start("");
    let mut daemon = Daemon::on_port(&board.link(), ON);
    let at = daemon.monitor();
    until(at, "ready", |ready| ready["ready"] == true);
    comes_and_goes(at, &mut board, "psd-dark 1", "optics", "PSD_B_LOW");
    comes_and_goes(at, &mut board, "stalled", "samples", "SOURCE_DOWN");
    let ordered = board.order("beam-blocked 1");
    let dark = "PSD_A_LOW, PSD_B_LOW, PSD_C_LOW";
    let blocked = until(at, "blocked", |ready| check(ready, "optics")["reason"] == dark);
    within_a_second(&blocked, "optics", ordered);
    assert_eq!(check(&blocked, "samples")["ok"], true, "{blocked}");
    let lock = check(&blocked, "lock")["reason"].as_str().unwrap();
    let (state, cause) = lock.split_once(": ").expect("state and cause");
    assert!(["held", "lost", "searching"].contains(&state) && !cause.is_empty(), "{blocked}");
    until(at, "ready again", |ready| ready["ready"] == true);
}

#[test]
fn without_a_board_the_daemon_is_healthy_and_not_ready() {
    let mut daemon = Daemon::on_port("/dev/no-such-board".as_ref(), ON);
    let at = daemon.monitor();
    let cause = "SOURCE_DOWN: cannot open /dev/no-such-board: does not exist; ";
    let ready = until(at, "seen", |ready| {
        check(ready, "samples")["reason"].as_str().is_some_and(|reason| reason.starts_with(cause))
    });
    assert_eq!(ready["ready"], false);
    assert_eq!(get(at, "/healthz").code, 200);
}

#[test]
fn a_loop_that_is_off_is_not_ready() {
    let mut daemon = Daemon::start(&format!("{ON}centering.mode = \"off\"\n"));
    let at = daemon.monitor();
    let ready = until(at, "optics are fine", |ready| check(ready, "optics")["ok"] == true);
    assert_eq!(check(&ready, "lock")["reason"], "off: switched off");
    assert_eq!(get(at, "/healthz").code, 200);
}

/// A daemon with a fast thread that can be stopped, as by a debugger or a defect.
struct Holder(Daemon);

impl Holder {
    fn start() -> Self {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/system/monitor/hold.py");
        // No limit for stalls: the thread is stopped for the length of the test.
        let config = format!(
            "{ON}publishing.tcp = \"off\"
realtime.stall_ms = 0
"
        );
        Self(Daemon::start_through(&Folder::new(), &config, &["python3", script, "fast"]))
    }

    fn next(&mut self) {
        self.0
            .orders
            .as_mut()
            .unwrap()
            .write_all(
                b"
",
            )
            .unwrap();
    }
}

impl Drop for Holder {
    fn drop(&mut self) {
        drop(self.0.orders.take()); // the end of its input ends the script, and the daemon with it
        self.0.end();
    }
}

#[test]
fn a_stopped_fast_side_is_not_healthy() {
    let mut daemon = Holder::start();
    let at = daemon.0.monitor();
    until(at, "ready", |ready| ready["ready"] == true);
    let held_ns = now_ns();
    daemon.next();
    // The check of the tasks may fail slightly earlier, with another reason.
    let silent =
        |check: &Value| check["reason"].as_str().is_some_and(|why| why.contains("has made no frame"));
    let dead = until(at, "dead", |ready| ready["checks"].as_array().unwrap().iter().all(silent));
    within_a_second(&dead, "samples", held_ns);
    let page = get(at, "/healthz");
    assert_eq!(page.code, 503, "{page:?}");
    assert!(page.body.contains("the fast side has made no frame"), "{page:?}");
    nothing_stays_green(at);
    assert!(!get(at, "/metrics").body.contains("trifacet_lock_state{"), "the lock state is unknown");
    daemon.next();
    until(at, "ready again", |ready| ready["ready"] == true);
    assert_eq!(get(at, "/healthz").code, 200);
}
