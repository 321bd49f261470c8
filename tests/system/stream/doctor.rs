//! `trifacet doctor` reports each problem and its remedy.

use std::io::Write;
use std::net::{TcpListener, UdpSocket};

use trifacet::client::PoseFrame;
use trifacet::exit;
use trifacet_wire::{LockState, Status};

use super::fixture::{frame, publishing};
use crate::testkit::{run, trifacet};

/// The exit code and the output.
fn doctor(args: &[&str]) -> (i32, String) {
    let done = run(trifacet(&["doctor"]).args(args));
    (done.code, done.out + &done.err)
}

/// Checks that the output contains these texts, and that there are no valid poses.
fn wrong(args: &[&str], told: &[&str]) {
    let (code, text) = doctor(args);
    assert_eq!(code, i32::from(exit::UNAVAILABLE), "{text}");
    for part in told.iter().chain(&["WRONG", "->"]) {
        assert!(text.contains(part), "does not contain {part}:\n{text}");
    }
}

#[test]
fn a_daemon_without_faults_is_reported_as_such_over_every_transport() {
    let receiver = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let keys = format!("tcp = '127.0.0.1:0'\nudp = ['{receiver}']\nsubscribe = '127.0.0.1:0'");
    let mut daemon = publishing(&keys);
    let (tcp, subscribe) = (daemon.address(), daemon.subscriptions());
    for endpoint in [format!("tcp://{tcp}"), format!("udp://{receiver}"), format!("subscribe://{subscribe}")]
    {
        let (code, text) = doctor(&[&endpoint]);
        assert_eq!(code, 0, "{text}");
        assert!(text.contains("poses are valid") && text.contains("SIMULATED"), "{text}");
        assert!(!text.contains("WRONG") && !text.contains("clock error"), "{text}");
    }
}

#[test]
fn faults_of_the_light_are_reported() {
    let mut daemon = publishing(
        "tcp = '127.0.0.1:0'\nudp = []\n[centering]\nsearch = false\n[[twin.fault]]\nat_s = 0.0\nkind = 'psd-dark'\npsd = 1",
    );
    wrong(&[&format!("tcp://{}", daemon.address())], &["not valid", "PSD_B_LOW", "NOT_LOCKED"]);
    let mut daemon =
        publishing("tcp = '127.0.0.1:0'\nudp = []\n[[twin.fault]]\nat_s = 0.0\nkind = 'beam-blocked'");
    wrong(&[&format!("tcp://{}", daemon.address())], &["no light on any PSD", "check that the laser is on"]);
    let mut daemon = publishing(
        "tcp = '127.0.0.1:0'\nudp = []\n[acquisition]\nsource = 'serial'\n[acquisition.serial]\nport = '/dev/no-board'",
    );
    wrong(&[&format!("tcp://{}", daemon.address())], &["SOURCE_DOWN", "plugged in"]);
}

#[test]
fn faults_of_the_link_are_reported() {
    let closed = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    wrong(&[&format!("tcp://{closed}")], &["nothing listens", "trifacet run"]);
    wrong(&[&format!("subscribe://{closed}")], &["no server for subscriptions", "[publishing] subscribe"]);

    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let own = format!("process {} (", std::process::id());
    wrong(&[&format!("udp://{}", taken.local_addr().unwrap())], &["taken by", &own]);
    wrong(&["udp://203.0.113.77:7362"], &["no interface of this machine has this address"]);

    let mut daemon = publishing("tcp = '127.0.0.1:0'\nudp = []\nallow = ['10.0.0.0/8']");
    wrong(&[&format!("tcp://{}", daemon.address())], &["refused", "[publishing] allow"]);
}

#[test]
fn the_reason_for_missing_datagrams_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lab.toml");
    let closed = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let free = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    std::fs::write(&file, format!("[publishing]\ntcp = '{closed}'\nudp = ['{free}']\n")).unwrap();
    let config = ["--config", file.to_str().unwrap()];
    let elsewhere = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    wrong(
        &[&[format!("udp://{elsewhere}").as_str()], &config[..]].concat(),
        &["sends none to", &free.to_string()],
    );
    wrong(
        &[&[format!("udp://{free}").as_str()], &config[..]].concat(),
        &["no daemon answers", "trifacet run"],
    );
}

/// A server that sends these bytes to every client.
fn serve(bytes: Vec<u8>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        let clients: Vec<_> = listener
            .incoming()
            .map(|client| {
                let mut client = client.unwrap();
                client.write_all(&bytes).unwrap();
                client
            })
            .collect();
        drop(clients);
    });
    format!("tcp://{address}")
}

#[test]
fn a_short_loss_of_the_lock_is_reported_with_its_duration() {
    let frames = |lost: u64, last: LockState| {
        let held = Status::POSE_VALID | Status::NOT_LOCKED;
        let of = |n| {
            let (status, lock) = if n < lost { (held, LockState::Held) } else { (Status::POSE_VALID, last) };
            PoseFrame { status, lock, ..frame(n) }
        };
        (0..10).flat_map(|n| of(n).encode()).collect()
    };
    let (code, text) = doctor(&[&serve(frames(3, LockState::Locked))]);
    assert_eq!(code, 0, "{text}");
    assert!(text.contains("NOT_LOCKED: was not locked for 3 of 10 frames"), "{text}");
    assert!(text.contains("the loop lost its lock for a short time, and has it again"), "{text}");
    let (_, text) = doctor(&[&serve(frames(10, LockState::Held))]);
    assert!(text.contains("NOT_LOCKED: the lock state is held"), "{text}");
}

#[test]
fn another_version_another_program_and_a_clock_error_are_distinguished() {
    let mut other = frame(0).encode();
    other[4] = 9;
    let crc = crc32fast::hash(&other[..188]);
    other[188..].copy_from_slice(&crc.to_le_bytes());
    wrong(&[&serve(other.to_vec())], &["version 9.1", "same version"]);
    wrong(&[&serve(b"220 mail ready\r\n".to_vec())], &["do not belong to this stream", "another program"]);
    wrong(&[&serve(Vec::new())], &["sends nothing"]);
    // Frames with times of 1970 still contain valid poses.
    let old: Vec<u8> = (0..10).flat_map(|n| PoseFrame { time_ns: 0, ..frame(n) }.encode()).collect();
    let (code, text) = doctor(&[&serve(old)]);
    assert_eq!(code, 0, "{text}");
    assert!(text.contains("clock error") && text.contains("NTP"), "{text}");
}
