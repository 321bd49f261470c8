//! A task that makes no turns: nothing stays green, and everybody hears which it is.

use std::net::SocketAddr;
use std::path::Path;

use serde_json::Value;
use trifacet_wire::{LockState, Status};

use super::page::{nothing_stays_green, until};
use crate::testkit::http::get;
use crate::testkit::{Daemon, now_ns, on};

/// A daemon that leaves time to look before it ends, and its pages.
fn daemon() -> (Daemon, SocketAddr) {
    let mut daemon = Daemon::start("monitor.listen = \"127.0.0.1:0\"\nrealtime.stall_ms = 4000\n");
    let at = daemon.monitor();
    until(at, "ready", |ready| ready["ready"] == true);
    (daemon, at)
}

fn reasons(ready: &Value) -> Vec<&str> {
    ready["checks"].as_array().unwrap().iter().filter_map(|check| check["reason"].as_str()).collect()
}

/// Every check, health and metrics name the task before the daemon ends, and the log says why it did.
fn is_named_before_the_end(what: &str) {
    for task in ["acquisition", "centering", "estimation"] {
        let (mut daemon, at) = daemon();
        daemon.told(&["drill", what, task]);
        let name = format!("task {task} stalled");
        let named = |ready: &Value| reasons(ready).iter().filter(|why| why.starts_with(&name)).count();
        until(at, &name, |ready| named(ready) == 3);
        let health = get(at, "/healthz");
        assert!(health.code == 503 && health.body.starts_with(&name), "{health:?}");
        nothing_stays_green(at);
        assert_eq!(daemon.end().code(), Some(70), "{what} {task}");
        assert!(daemon.said(&format!("task {task} stalls: no heartbeat for 4000 ms")), "{:#?}", daemon.log);
    }
}

#[test]
fn a_task_that_waits_for_ever_is_named_before_the_end() {
    is_named_before_the_end("stall");
}

#[test]
fn a_task_that_never_comes_back_is_named_before_the_end() {
    is_named_before_the_end("block");
}

/// `trifacet status` misses what only the control socket knows, and says why.
fn status_tells_of_it(address: SocketAddr, socket: &Path) {
    let address = format!("tcp://{address}");
    let page = on(&["status", &address, "--socket"], socket).out;
    assert!(page.contains("lock      held\n"), "{page}");
    assert!(page.contains(&format!("control   {} does not answer\n", socket.display())), "{page}");
}

#[test]
fn frames_claim_no_lock_of_a_loop_that_stands_still() {
    let (mut daemon, at) = daemon();
    let mut stream = daemon.client();
    daemon.told(&["drill", "stall", "centering"]);
    let before_ns = now_ns();
    let first = stream.until("not locked", |frame| frame.time_ns > before_ns && !frame.locked());
    assert!(first.time_ns - before_ns < 1_000_000_000, "by the daemon's time stamps: {first:?}");
    until(at, "not ready", |ready| ready["ready"] == false);
    status_tells_of_it(daemon.address(), &daemon.socket());
    let line = "trifacet_lock_state{state=\"held\"} 1";
    assert!(get(at, "/metrics").body.contains(line), "what the frames say is known");
    for frame in std::iter::once(first).chain(stream.take(500)) {
        assert!(frame.lock == LockState::Held && frame.has(Status::NOT_LOCKED), "{frame:?}");
        assert!(frame.valid(), "estimation goes on: {frame:?}");
    }
}
