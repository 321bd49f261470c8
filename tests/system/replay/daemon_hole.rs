//! A replay across a gap in the recording, and after its end.

use rustix::process::Signal;
use serde_json::Value;
use trifacet::client::PoseFrame;
use trifacet_wire::{LockState, Status};

use super::daemon::{Player, bytes, frames};
use super::fixture::Lab;
use crate::testkit::{Daemon, http, on, run, trifacet, wait_for};

/// A recording of four chunks, the second of which is unreadable.
fn with_a_hole(lab: &Lab) -> Vec<PoseFrame> {
    let file = lab.record("a.mcap", "", 9000);
    let then = frames(&file);
    let mut all = std::fs::read(&file).unwrap();
    let second = all.len() * 3 / 8;
    all[second..second + 8].fill(0x55);
    lab.write("hole.mcap", all);
    then
}

/// Checks that a frame contains neither a pose nor a lock, and that its time advances.
fn is_silence(frame: &PoseFrame, before: &PoseFrame) {
    let down = Status::SOURCE_DOWN | Status::REPLAYED | Status::NOT_LOCKED;
    assert!(frame.status.has(down) && !frame.status.has(Status::POSE_VALID), "{frame:?}");
    assert!(frame.pose.iter().all(|x| x.is_nan()) && frame.steering[0].is_nan(), "{frame:?}");
    assert_eq!((frame.lock, frame.sample_index, frame.averaged), (LockState::Held, before.sample_index, 0));
    assert!(frame.time_ns > before.time_ns, "{frame:?} after {before:?}");
}

/// The reason of the first check of `/readyz`, once the monitor has received a frame.
fn why_not_ready(daemon: &mut Daemon) -> Value {
    let at = daemon.monitor();
    wait_for("seen", || {
        let page = http::get(at, "/readyz");
        assert_eq!(page.code, 503, "{page:?}");
        let ready: Value = serde_json::from_str(&page.body).unwrap();
        let first = &ready["checks"][0];
        if first["since"].is_null() { Err(page.body) } else { Ok(first["reason"].clone()) }
    })
}

#[test]
fn frames_continue_across_a_gap_and_the_first_one_after_it_contains_the_loss() {
    let lab = Lab::new();
    let then = with_a_hole(&lab);
    let mut daemon =
        Player::start(&lab, "acquisition.source = 'replay'\nreplay = { file = 'hole.mcap', speed = 4 }");
    let mut last = daemon.frame();
    let (mut silent, mut behind, mut now) = (0, None, vec![last]);
    assert_eq!(why_not_ready(&mut daemon), "REPLAYED");
    while last.sample_index < then.last().unwrap().sample_index {
        let frame = daemon.frame();
        assert_eq!(frame.sequence, last.sequence + 1);
        if frame.status.has(Status::SOURCE_DOWN) {
            assert!(behind.is_none(), "a second gap: {frame:?}");
            is_silence(&frame, &last);
            silent += 1;
        } else {
            if last.status.has(Status::SOURCE_DOWN) {
                assert!(frame.status.has(Status::SAMPLE_GAP | Status::POSE_VALID), "{frame:?}");
                assert_eq!(u64::from(frame.lost), frame.sample_index - last.sample_index - 1);
                behind = Some(frame);
            }
            now.push(frame);
        }
        assert!(frame.time_ns >= last.time_ns);
        last = frame;
    }
    let behind = behind.expect("a gap");
    assert!(behind.lost > 2000 && silent > 10, "{silent} frames in the gap before {behind:?}");
    // All other frames are the original ones.
    for frame in now.iter_mut().filter(|frame| frame.sequence == behind.sequence) {
        frame.lost = 0;
        frame.status.0 &= !Status::SAMPLE_GAP.0;
    }
    let mut then = then.into_iter();
    for frame in now {
        let recorded = then.find(|then| then.sample_index == frame.sample_index).unwrap();
        assert_eq!(bytes(frame), bytes(recorded), "{frame:?}");
    }
    let counters = &daemon.status()["counters"];
    assert_eq!((&counters["scans_lost"], &counters["replay_holes"]), (&behind.lost.into(), &1.into()));
    assert!(counters["scans"].as_u64() > Some(5000) && counters["lock_locked"] == 1, "{counters}");
    daemon.ends_in_order(Signal::TERM);
}

#[test]
fn the_end_of_a_replay_is_reported_everywhere() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 600);
    let then = frames(&file);
    let mut daemon = Player::start(&lab, "acquisition.source = 'replay'\nreplay.file = 'a.mcap'");
    let mut last = daemon.frame();
    let began = daemon.status();
    let (replay, pose) = (&began["replay"], &began["pose"]);
    assert!(replay["recorded"].as_str().unwrap().starts_with("1970-01-01T00:00:00."), "{began}");
    assert!(replay["at_end"] == false && pose["age_s"].is_null(), "{began}");
    while last.sample_index < then.last().unwrap().sample_index {
        last = daemon.frame();
    }
    for _ in 0..5 {
        let frame = daemon.frame();
        is_silence(&frame, &last);
        last = frame;
    }
    let status = daemon.status();
    assert_eq!(status["replay"]["at_end"], true, "{status}");
    assert_eq!(status["loop"]["lock"], "held", "{status}");
    assert!(status["loop"]["commanded_um"].is_null() && status["pose"]["valid"] == false, "{status}");
    let tcp = daemon.tcp();
    let shown = run(trifacet(&["status", &tcp, "--socket"]).arg(lab.path("socket"))).out;
    assert!(shown.contains("a.mcap, recorded 1970-01-01 00:00:00 UTC: ended"), "{shown}");
    assert!(shown.contains("held   replayed: no steering"), "{shown}");
    let told = on(&["doctor", &tcp, "--config"], &lab.path("daemon.toml"));
    assert!(told.code == 69 && told.out.contains("WRONG  the recording has ended"), "{}", told.out);
    for nonsense in ["powered", "NTP", "stuck", "NOT_LOCKED"] {
        assert!(!told.out.contains(nonsense), "{}", told.out);
    }
    assert_eq!(why_not_ready(&mut daemon), "SOURCE_DOWN, REPLAYED");
    daemon.ends_in_order(Signal::TERM);
}

#[test]
fn the_doctor_detects_a_replay_and_no_clock_error() {
    let lab = Lab::new();
    lab.record("a.mcap", "", 2000);
    let config = "acquisition.source = 'replay'\nreplay = { file = 'a.mcap', repeat = true }";
    let mut daemon = Player::start(&lab, config);
    while !daemon.frame().status.has(Status::POSE_VALID) {}
    let told = on(&["doctor", &daemon.tcp(), "--config"], &lab.path("daemon.toml"));
    assert_eq!(told.code, 0, "{} {}", told.out, told.err);
    assert!(told.out.contains("a replay of a.mcap, recorded 1970-01-01T00:00:00."), "{}", told.out);
    assert!(!told.out.contains("NTP") && !told.out.contains("clock"), "{}", told.out);
    daemon.ends_in_order(Signal::TERM);
}

#[test]
fn an_unattainable_replay_speed_does_not_end_the_daemon() {
    let lab = Lab::new();
    lab.record("a.mcap", "acquisition.rate_hz = 10000", 60_000);
    let config = "acquisition.source = 'replay'\nreplay = { file = 'a.mcap', speed = 1000, repeat = true }";
    let mut daemon = Player::start(&lab, config);
    let mut frame = daemon.frame();
    while frame.sequence < 300_000 {
        frame = daemon.frame();
        assert!(!frame.status.has(Status::SOURCE_DOWN), "{frame:?}");
    }
    assert!(daemon.status()["counters"]["replay_ends"].as_u64() >= Some(4));
    daemon.ends_in_order(Signal::TERM);
}
