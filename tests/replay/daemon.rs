//! A daemon whose source is a recording, and a recording of a daemon.

use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use trifacet::client::PoseFrame;
use trifacet::clock::{Clock, SystemClock};
use trifacet::estimation::Status;
use trifacet::recording::reader::{Read, Reader};
use trifacet::recording::{Entry, Topic};

use crate::fixture::{Lab, on, run, trifacet};

const PATIENCE: Duration = Duration::from_mins(1);

/// Killed when dropped.
struct Daemon(Child, UdpSocket);

impl Daemon {
    fn start(lab: &Lab, config: &str) -> Self {
        let udp = UdpSocket::bind("127.0.0.1:0").unwrap();
        udp.set_read_timeout(Some(PATIENCE)).unwrap();
        rustix::net::sockopt::set_socket_recv_buffer_size(&udp, 1 << 22).unwrap();
        let to = udp.local_addr().unwrap();
        let text = format!(
            "publishing = {{ tcp = \"off\", udp = [\"{to}\"] }}\nmonitor.listen = \"off\"\n\
             control.socket = \"{}\"\n{config}\n",
            lab.path("socket").display()
        );
        let file = lab.write("daemon.toml", text);
        let child = trifacet(&["run", "--config"]).arg(file).stderr(Stdio::null()).spawn().unwrap();
        Self(child, udp)
    }

    fn frame(&self) -> PoseFrame {
        let mut bytes = [0; 300];
        let n = self.1.recv(&mut bytes).unwrap();
        PoseFrame::decode(&bytes[..n]).unwrap()
    }

    fn end(mut self) {
        kill_process(Pid::from_child(&self.0), Signal::TERM).unwrap();
        assert!(self.0.wait().unwrap().success());
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn frames(file: &Path) -> Vec<PoseFrame> {
    let mut reader = Reader::open(file, &[Topic::Frame]).unwrap();
    std::iter::from_fn(|| reader.read().unwrap())
        .map(|read| match read {
            Read::Entry(Entry::Frame { frame, .. }) => frame,
            other => panic!("{other:?}"),
        })
        .collect()
}

/// All that does not come from the moment of sending.
fn bytes(mut frame: PoseFrame) -> Vec<u8> {
    (frame.session, frame.sequence, frame.solve_delay_ns, frame.send_delay_ns) = (0, 0, 0, 0);
    frame.status.0 &= !Status::REPLAYED.0;
    frame.encode().to_vec()
}

#[test]
fn a_daemon_that_replays_sends_what_was_sent_then() {
    let lab = Lab::new();
    let stalled = "[[twin.fault]]\nkind = 'stalled'\nat_s = 0.7\nfor_s = 0.3";
    let file = lab.record("a.mcap", stalled, 2000);
    let then = frames(&file);
    let start = SystemClock.now();
    let daemon = Daemon::start(&lab, "acquisition.source = 'replay'\nreplay.file = 'a.mcap'");
    for (n, then) in then.iter().enumerate() {
        let now = daemon.frame();
        assert!(now.status.has(Status::REPLAYED), "{now:?}");
        assert_eq!(bytes(now), bytes(*then), "frame {n}: {now:?}");
    }
    assert!(SystemClock.now().seconds_since(start) > 1.99, "at the recorded pace");
    // Nothing steers, and that is said.
    for order in [["loop", "on"], ["loop", "manual"]] {
        let socket = lab.path("socket");
        let done = run(trifacet(&["ctl", "--socket"]).arg(&socket).args(order));
        assert!(
            done.code == 64 && done.err.contains("a recording is replayed"),
            "{} {}",
            done.code,
            done.err
        );
    }
    let end = daemon.frame();
    assert!(end.status.has(Status::SOURCE_DOWN | Status::REPLAYED) && end.pose[0].is_nan(), "{end:?}");
    assert!(end.time_ns > then.last().unwrap().time_ns);
    daemon.end();
}

#[test]
fn it_can_begin_again_and_does_not_steer_a_real_stage() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 300);
    let then = frames(&file);
    let config = "acquisition.source = 'replay'\nreplay = { file = 'a.mcap', speed = 3, repeat = true }";
    let daemon = Daemon::start(&lab, config);
    let indices: Vec<u64> = (0..700).map(|_| daemon.frame().sample_index).collect();
    assert_eq!(indices[..300], indices[300..600]);
    assert_eq!(indices[0], then[0].sample_index);
    daemon.end();
    for (key, named) in
        [("steering.kind = 'gcs'", "steering.kind"), ("recording.mode = 'always'", "recording.mode")]
    {
        let text = format!("acquisition.source = 'replay'\nreplay.file = 'a.mcap'\n{key}\n");
        let done = on(&["check", "--config"], &lab.write("wrong.toml", text));
        assert!(done.code == 78 && done.err.contains(named), "{key}: {} {}", done.code, done.err);
    }
    let nothing = lab.write("nothing.toml", "acquisition.source = 'replay'\nreplay.file = 'no.mcap'\n");
    let done = on(&["run", "--config"], &nothing);
    assert!(done.code == 74 && done.err.contains("no.mcap"), "{} {}", done.code, done.err);
}

#[test]
fn what_a_daemon_has_recorded_is_computed_again_bit_by_bit() {
    let lab = Lab::new();
    let config = "recording = { folder = 'recordings', mode = 'always' }\nacquisition.rate_hz = 2000\n\
                  twin.channel_skew_us = 20\n[[twin.fault]]\nkind = 'stalled'\nat_s = 1.0\nfor_s = 0.3";
    let daemon = Daemon::start(&lab, config);
    let first = daemon.frame();
    while daemon.frame().time_ns - first.time_ns < 1_500_000_000 {}
    let done = run(trifacet(&["ctl", "--socket"]).arg(lab.path("socket")).args(["tare"]));
    assert_eq!(done.code, 0, "{}", done.err);
    while daemon.frame().time_ns - first.time_ns < 3_000_000_000 {}
    daemon.end();
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
