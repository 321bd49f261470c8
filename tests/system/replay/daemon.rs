//! A daemon that replays a recording, and the replay of a recording that a daemon made.

use std::ops::{Deref, DerefMut};
use std::path::Path;

use rustix::process::Signal;
use trifacet::client::PoseFrame;
use trifacet::clock::SystemClock;
use trifacet::core::time::Clock;
use trifacet::recording::reader::{Read, Reader};
use trifacet::recording::{Entry, Topic};
use trifacet_wire::Status;

use super::fixture::Lab;
use crate::testkit::{Daemon, Udp, on};

/// A daemon in a folder with recordings, and its datagrams.
pub(crate) struct Player {
    daemon: Daemon,
    udp: Udp,
}

impl Deref for Player {
    type Target = Daemon;

    fn deref(&self) -> &Daemon {
        &self.daemon
    }
}

impl DerefMut for Player {
    fn deref_mut(&mut self) -> &mut Daemon {
        &mut self.daemon
    }
}

impl Player {
    pub(crate) fn start(lab: &Lab, config: &str) -> Self {
        let udp = Udp::open();
        let text = format!(
            "publishing.udp = [\"{}\"]
monitor.listen = \"127.0.0.1:0\"
{config}
",
            udp.address()
        );
        Self { daemon: Daemon::start_in(&lab.0, &text), udp }
    }

    pub(crate) fn frame(&self) -> PoseFrame {
        self.udp.frame()
    }

    /// The address for TCP clients.
    pub(crate) fn tcp(&mut self) -> String {
        format!("tcp://{}", self.address())
    }
}

pub(crate) fn frames(file: &Path) -> Vec<PoseFrame> {
    let mut reader = Reader::open(file, &[Topic::Frame]).unwrap();
    std::iter::from_fn(|| reader.read().unwrap())
        .map(|read| match read {
            Read::Entry(Entry::Frame { frame, .. }) => frame,
            other => panic!("{other:?}"),
        })
        .collect()
}

/// The bytes of a frame without those that depend on the time of sending.
pub(crate) fn bytes(mut frame: PoseFrame) -> Vec<u8> {
    (frame.session, frame.sequence, frame.solve_delay_ns, frame.send_delay_ns) = (0, 0, 0, 0);
    frame.status.0 &= !Status::REPLAYED.0;
    frame.encode().to_vec()
}

#[test]
fn a_replaying_daemon_sends_the_original_frames() {
    let lab = Lab::new();
    let stalled = "[[twin.fault]]\nkind = 'stalled'\nat_s = 0.7\nfor_s = 0.3";
    let file = lab.record("a.mcap", stalled, 2000);
    let then = frames(&file);
    let start = SystemClock.now();
    let mut daemon = Player::start(&lab, "acquisition.source = 'replay'\nreplay.file = 'a.mcap'");
    for (n, then) in then.iter().enumerate() {
        let now = daemon.frame();
        assert!(now.status.has(Status::REPLAYED), "{now:?}");
        assert_eq!(bytes(now), bytes(*then), "frame {n}: {now:?}");
    }
    assert!(SystemClock.now().seconds_since(start) > 1.99, "at the recorded pace");
    // Commands to the loop and the recorder are refused with the reason.
    for order in [&["loop", "on"] as &[_], &["park"], &["record", "start"], &["reload"]] {
        let (code, _, errors) = daemon.ctl(order);
        assert!(code == 65 && errors.contains("a recording is replayed"), "{order:?}: {code} {errors}");
    }
    let end = daemon.frame();
    assert!(end.status.has(Status::SOURCE_DOWN | Status::REPLAYED) && end.pose[0].is_nan(), "{end:?}");
    assert!(end.time_ns > then.last().unwrap().time_ns);
    daemon.ends_in_order(Signal::TERM);
}

#[test]
fn a_replay_can_repeat_and_refuses_a_real_stage() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 300);
    let then = frames(&file);
    let config = "acquisition.source = 'replay'\nreplay = { file = 'a.mcap', speed = 3, repeat = true }";
    let mut daemon = Player::start(&lab, config);
    let indices: Vec<u64> = (0..700).map(|_| daemon.frame().sample_index).collect();
    assert_eq!(indices[..300], indices[300..600]);
    assert_eq!(indices[0], then[0].sample_index);
    let status = daemon.status();
    assert_eq!(status["replay"]["at_end"], false, "{status}");
    assert!(status["counters"]["replay_ends"].as_u64() >= Some(2), "{status}");
    daemon.ends_in_order(Signal::TERM);
    let told = daemon.log.iter().filter(|line| line["message"] == "the recording begins again").count();
    assert_eq!(told, 1, "the repetition is logged once");
    for (key, named) in
        [("steering.kind = 'gcs'", "steering.kind"), ("recording.mode = 'always'", "recording.mode")]
    {
        let text = format!("acquisition.source = 'replay'\nreplay.file = 'a.mcap'\n{key}\n");
        let done = on(&["check", "--config"], &lab.write("wrong.toml", text));
        assert!(done.code == 78 && done.err.contains(named), "{key}: {} {}", done.code, done.err);
    }
}

#[test]
fn a_file_that_is_not_a_recording_is_refused_at_the_start() {
    let lab = Lab::new();
    lab.write("text.mcap", "not a recording");
    lab.write("empty.mcap", "");
    let file = lab.record("a.mcap", "", 10);
    // All entries are in the only chunk.
    let bytes = std::fs::read(&file).unwrap();
    lab.write("head.mcap", &bytes[..40]);
    let fifo = lab.path("fifo.mcap");
    assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    for (name, why) in [
        ("no.mcap", "No such file"),
        ("text.mcap", "not an MCAP file"),
        ("empty.mcap", "not an MCAP file"),
        ("head.mcap", "so it cannot be replayed"),
        ("fifo.mcap", "not a regular file"),
        ("/dev/zero", "not a regular file"),
        (".", "not a regular file"),
    ] {
        let text = format!("acquisition.source = 'replay'\nreplay.file = '{name}'\nmonitor.listen = 'off'\n");
        let config = lab.write("wrong.toml", text + "publishing.tcp = 'off'\n");
        for command in ["check", "run"] {
            let done = on(&[command, "--config"], &config);
            let named = done.err.contains(why) && done.err.contains("replay.file");
            assert!(done.code == 78 && named, "{command} {name}: {} {}", done.code, done.err);
        }
    }
}

#[test]
fn check_prints_only_what_applies_to_a_replay() {
    let lab = Lab::new();
    lab.record("a.mcap", "head.psd_distance_mm = 300", 300);
    let config = lab.write("check.toml", "acquisition.source = 'replay'\nreplay.file = 'a.mcap'\n");
    let done = on(&["check", "--config"], &config);
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(
        done.out.contains("PSDs of 13 mm at 300 mm") && done.out.contains("recorded 1970-01-01T"),
        "{}",
        done.out
    );
    assert!(!done.out.contains("Kp") && !done.out.contains("full scale"), "{}", done.out);
    let id = on(&["info", "--json"], &lab.path("a.mcap")).out;
    let word = done.out.split("id ").nth(1).unwrap().split_whitespace().next().unwrap();
    assert!(id.contains(word), "{word}: {id}");
}

#[test]
fn a_recording_of_a_daemon_replays_bit_by_bit() {
    let lab = Lab::new();
    let config = "recording = { folder = 'recordings', mode = 'always' }\nacquisition.rate_hz = 2000\n\
                  twin.channel_skew_us = 20\n[[twin.fault]]\nkind = 'stalled'\nat_s = 1.0\nfor_s = 0.3";
    let mut daemon = Player::start(&lab, config);
    let first = daemon.frame();
    while daemon.frame().time_ns - first.time_ns < 1_500_000_000 {}
    daemon.told(&["tare"]);
    while daemon.frame().time_ns - first.time_ns < 3_000_000_000 {}
    daemon.ends_in_order(Signal::TERM);
    let folder = std::fs::read_dir(lab.path("recordings")).unwrap();
    let files: Vec<_> = folder
        .map(|file| file.unwrap().path())
        .filter(|f| f.extension().is_some_and(|e| e == "mcap"))
        .collect();
    assert_eq!(files.len(), 1, "{files:?}");
    let done = on(&["replay"], &files[0]);
    assert_eq!(done.code, 0, "{} {}", done.out, done.err);
    let words: Vec<u64> = done.out.split_ascii_whitespace().filter_map(|word| word.parse().ok()).collect();
    assert!(words[0] == words[1] && words[0] > 4000, "{}", done.out);
}
