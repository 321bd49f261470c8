//! A stalled task: no check stays green, and health, metrics, frames and the log report it by name.

use std::net::SocketAddr;
use std::path::Path;

use serde_json::Value;
use trifacet_wire::{LockState, Status};

use super::page::{nothing_stays_green, until};
use crate::testkit::http::get;
use crate::testkit::{Daemon, now_ns, on};

/// A daemon with a long stall time, so that its pages can be read before it ends; and their address.
fn daemon() -> (Daemon, SocketAddr) {
    let mut daemon = Daemon::start("monitor.listen = \"127.0.0.1:0\"\nrealtime.stall_ms = 4000\n");
    let at = daemon.monitor();
    until(at, "ready", |ready| ready["ready"] == true);
    (daemon, at)
}

fn reasons(ready: &Value) -> Vec<&str> {
    ready["checks"].as_array().unwrap().iter().filter_map(|check| check["reason"].as_str()).collect()
}

/// Readiness, health and metrics name the task before the daemon ends, and the log states the cause of the
/// end.
fn is_named_before_the_end(what: &str) {
    for task in ["acquisition", "centering", "estimation"] {
        let (mut daemon, at) = daemon();
        daemon.told(&["drill", what, task]);
        let name = format!("task {task} stalled");
        let named = |ready: &Value| reasons(ready).iter().all(|why| why.starts_with(&name));
        let failing =
            |ready: &Value| ready["checks"].as_array().unwrap().iter().all(|check| check["ok"] == false);
        until(at, &name, |ready| failing(ready) && named(ready));
        let health = get(at, "/healthz");
        assert!(health.code == 503 && health.body.starts_with(&name), "{health:?}");
        nothing_stays_green(at);
        assert_eq!(daemon.end().code(), Some(70), "{what} {task}");
        assert!(daemon.said(&format!("task {task} stalls: no heartbeat for 4000 ms")), "{:#?}", daemon.log);
    }
}

#[test]
fn a_task_that_waits_forever_is_named_before_the_end() {
    is_named_before_the_end("stall");
}

#[test]
fn a_task_that_never_returns_is_named_before_the_end() {
    is_named_before_the_end("block");
}

/// `trifacet status` omits the data of the control socket, and states the reason.
fn status_reports_it(address: SocketAddr, socket: &Path) {
    let address = format!("tcp://{address}");
    let page = on(&["status", &address, "--socket"], socket).out;
    assert!(page.contains("lock      held\n"), "{page}");
    assert!(page.contains(&format!("control   {} does not answer\n", socket.display())), "{page}");
}

#[test]
fn frames_report_no_lock_of_a_stalled_loop() {
    let (mut daemon, at) = daemon();
    let mut stream = daemon.client();
    daemon.told(&["drill", "stall", "centering"]);
    let before_ns = now_ns();
    let first = stream.until("not locked", |frame| frame.time_ns > before_ns && !frame.locked());
    assert!(first.time_ns - before_ns < 1_000_000_000, "by the daemon's time stamps: {first:?}");
    until(at, "not ready", |ready| ready["ready"] == false);
    status_reports_it(daemon.address(), &daemon.socket());
    let line = "trifacet_lock_state{state=\"held\"} 1";
    assert!(get(at, "/metrics").body.contains(line), "the metrics have the lock state of the frames");
    for frame in std::iter::once(first).chain(stream.take(500)) {
        assert!(frame.lock == LockState::Held && frame.has(Status::NOT_LOCKED), "{frame:?}");
        assert!(frame.valid(), "estimation continues: {frame:?}");
    }
}
