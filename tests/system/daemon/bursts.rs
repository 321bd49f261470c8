//! Boards whose scans arrive in bursts, as through some USB hubs.

use serde_json::Value;
use trifacet_wire::LockState;

use crate::testkit::{Board, Daemon, Frame};

/// Longer than one burst, so that an interrupted burst is no silence.
const PATIENT: &str = "acquisition.silence_ms = 1000\nrealtime.stall_ms = 0\n";

#[test]
fn in_bursts_the_poses_stay_valid_and_the_loop_says_that_its_delay_is_too_short() {
    let mut board = Board::start("");
    let mut daemon = Daemon::on_port(&board.link(), PATIENT);
    let mut stream = daemon.client();
    stream.locked();
    let ordered_ns = board.order("bursts 100 4");
    stream.until("held", |f| f.sent_ns() > ordered_ns && f.lock == LockState::Held);
    let late = "samples arrive later than centering.loop_delay_ms";
    daemon.says(late, |line: &Value| line["message"] == "lock" && line["cause"] == late);
    let through = stream.through("locked without bursts", Frame::locked);
    let lasted_s = (through[through.len() - 1].time_ns - ordered_ns) as f64 * 1e-9;
    assert!(lasted_s > 4.0, "locked after {lasted_s} s");
    // No sample is lost, each has its own time, and all poses are valid.
    assert!(through.iter().all(|f| f.of_samples() && f.valid()));
    let steps =
        through.windows(2).map(|w| (w[1].time_ns - w[0].time_ns, w[1].sample_index - w[0].sample_index));
    for (ns, samples) in steps {
        assert!(ns > 0 && samples == 1, "{ns} ns, {samples} samples");
    }
    let first = &through[0];
    let span_s = (through[through.len() - 1].time_ns - first.time_ns) as f64 * 1e-9;
    let samples_s = (through.len() - 1) as f64 * 1e-3;
    assert!((span_s - samples_s).abs() < 0.05, "{span_s} {samples_s}");
    assert_eq!(stream.heartbeat().counters["source_downs"], 0);
}

#[test]
fn in_bursts_a_loop_with_a_longer_delay_locks() {
    let mut board = Board::start("twin.motion = []");
    board.order("bursts 100");
    let slow = format!("{PATIENT}steering.lease_ms = 2000\ncentering.loop_delay_ms = 400");
    let mut daemon = Daemon::on_port(&board.link(), &slow);
    let mut stream = daemon.client();
    stream.locked();
    assert!(stream.samples(1000).iter().all(|f| f.valid() && f.lock != LockState::Held));
}

#[test]
fn without_a_longer_silence_the_source_is_down_between_bursts() {
    let mut board = Board::start("");
    let mut daemon = Daemon::on_port(&board.link(), "");
    let mut stream = daemon.client();
    stream.locked();
    board.order("bursts 100");
    stream.until("no samples between bursts", |f| !f.of_samples());
    stream.until("samples of a burst", Frame::of_samples);
    stream.until("no samples between bursts", |f| !f.of_samples());
    daemon.message("source is down");
}
