//! Healthy, ready, and the way there and back.

use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};

use serde_json::Value;
use tempfile::NamedTempFile;

use super::page::{get, monitor, nothing_stays_green, opened, until};
use crate::testkit::{Board, Daemon, now_ns};

const ON: &str = "monitor.listen = \"127.0.0.1:0\"\n";

fn check<'a>(ready: &'a Value, name: &str) -> &'a Value {
    ready["checks"].as_array().unwrap().iter().find(|check| check["name"] == name).unwrap()
}

fn since_ns(ready: &Value, name: &str) -> i64 {
    let since: jiff::Timestamp = check(ready, name)["since"].as_str().unwrap().parse().unwrap();
    since.as_nanosecond() as i64
}

/// By the daemon's time stamps it was so within a second of the order; or before it, for samples that were due
/// by then and are made up for have it already.
fn within_a_second(ready: &Value, name: &str, ordered_ns: i64) {
    let late_ns = since_ns(ready, name) - ordered_ns;
    assert!(late_ns.abs() < 1_000_000_000, "{late_ns} ns: {ready}");
}

/// A fault of a while, seen to come and to go.
fn comes_and_goes(at: SocketAddr, board: &mut Board, fault: &str, name: &str, reason: &str) {
    let ordered = board.order(&format!("{fault} 1"));
    let gone = until(at, fault, |ready| check(ready, name)["reason"] == reason);
    within_a_second(&gone, name, ordered);
    let page = get(at, "/healthz");
    assert_eq!((page.code, &page.body[..]), (200, "ok\n"), "neither light nor board is the daemon");
    let back = until(at, "ready again", |ready| ready["ready"] == true);
    within_a_second(&back, name, ordered + 1_000_000_000);
}

#[test]
fn readiness_turns_within_a_second_and_names_the_reason() {
    let mut board = Board::start("");
    let mut daemon = Daemon::on_port(&board.link(), ON);
    let at = monitor(&mut daemon);
    until(at, "ready", |ready| ready["ready"] == true);
    comes_and_goes(at, &mut board, "psd-dark 1", "optics", "PSD_B_LOW");
    comes_and_goes(at, &mut board, "stalled", "samples", "SOURCE_DOWN");
    let ordered = board.order("beam-blocked 1");
    let dark = "PSD_A_LOW, PSD_B_LOW, PSD_C_LOW";
    let blocked = until(at, "blocked", |ready| check(ready, "optics")["reason"] == dark);
    within_a_second(&blocked, "optics", ordered);
    assert_eq!(check(&blocked, "samples")["ok"], true, "{blocked}");
    let lock = check(&blocked, "lock")["reason"].as_str().unwrap();
    assert!(["held", "lost", "searching"].contains(&lock), "{blocked}");
    until(at, "ready again", |ready| ready["ready"] == true);
}

#[test]
fn without_a_board_the_daemon_lives_and_is_not_ready() {
    let mut daemon = Daemon::on_port("/dev/no-such-board".as_ref(), ON);
    let at = monitor(&mut daemon);
    let ready = until(at, "seen", |ready| check(ready, "samples")["reason"] == "SOURCE_DOWN");
    assert_eq!(ready["ready"], false);
    assert_eq!(get(at, "/healthz").code, 200);
}

#[test]
fn a_loop_that_is_off_is_not_ready() {
    let mut daemon = Daemon::start(&format!("{ON}centering.mode = \"off\"\n"));
    let at = monitor(&mut daemon);
    let ready = until(at, "optics are fine", |ready| check(ready, "optics")["ok"] == true);
    assert_eq!(check(&ready, "lock")["reason"], "off");
    assert_eq!(get(at, "/healthz").code, 200);
}

/// A daemon whose fast thread can be held, as a debugger or a defect would.
struct Holder {
    child: Child,
    orders: ChildStdin,
    at: SocketAddr,
    _config: NamedTempFile,
}

impl Holder {
    fn start() -> Self {
        let config = NamedTempFile::new().unwrap();
        // Held for as long as the test takes.
        let text = format!(
            "{ON}publishing.tcp = \"off\"\npublishing.udp = []\nlog.format = \"json\"\nrealtime.stall_ms = 0\n"
        );
        std::fs::write(config.path(), text).unwrap();
        let mut child = Command::new("python3")
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/system/monitor/hold.py"))
            .args(["fast", env!("CARGO_BIN_EXE_trifacet"), "run", "--config"])
            .arg(config.path())
            .stdin(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let orders = child.stdin.take().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let at =
            lines.by_ref().find_map(|line| opened(&serde_json::from_str(&line.unwrap()).unwrap())).unwrap();
        std::thread::spawn(move || lines.for_each(drop));
        Self { child, orders, at, _config: config }
    }

    fn next(&mut self) {
        self.orders.write_all(b"\n").unwrap();
    }
}

impl Drop for Holder {
    fn drop(&mut self) {
        for _ in 0..3 {
            let _ = self.orders.write_all(b"\n"); // its last line ends it, and with it the daemon
        }
        let _ = self.child.wait();
    }
}

#[test]
fn a_fast_side_that_stands_still_is_not_alive() {
    let mut daemon = Holder::start();
    let at = daemon.at;
    until(at, "ready", |ready| ready["ready"] == true);
    let held_ns = now_ns();
    daemon.next();
    // That tasks stand still may be known a moment sooner.
    let silent =
        |check: &Value| check["reason"].as_str().is_some_and(|why| why.contains("has made no frame"));
    let dead = until(at, "dead", |ready| ready["checks"].as_array().unwrap().iter().all(silent));
    within_a_second(&dead, "samples", held_ns);
    let page = get(at, "/healthz");
    assert_eq!(page.code, 503, "{page:?}");
    assert!(page.body.contains("the fast side has made no frame"), "{page:?}");
    nothing_stays_green(at);
    assert!(!get(at, "/metrics").body.contains("trifacet_lock_state{"), "it is not known");
    daemon.next();
    until(at, "ready again", |ready| ready["ready"] == true);
    assert_eq!(get(at, "/healthz").code, 200);
}
