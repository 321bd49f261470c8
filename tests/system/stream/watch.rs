//! `trifacet watch` through the binary.

use std::io::{BufRead, BufReader};
use std::net::{SocketAddr, UdpSocket};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use trifacet::client::PoseFrame;
use trifacet::exit;
use trifacet::publishing::tcp::Limits;
use trifacet_wire::Status;

use super::fixture::{frame, start};
use crate::testkit;

/// A frame without a pose.
fn invalid(sequence: u64) -> PoseFrame {
    let status = Status::PSD_B_LOW | Status::SIMULATED;
    PoseFrame { status, pose: [f64::NAN; 6], deviations: [f32::NAN; 6], ..frame(sequence) }
}

/// A server on a thread of its own that sends frames, every tenth without a pose, for as long as the test
/// runs.
fn serve() -> SocketAddr {
    let (tell, address) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let server = start(Limits { clients: 8, queue: 1024, ..Limits::default() }).await;
            tell.send(server.address).unwrap();
            for sequence in 0.. {
                let frame = if sequence % 10 == 9 { invalid(sequence) } else { frame(sequence) };
                server.frames.send(frame).await.unwrap();
                tokio::time::sleep(Duration::from_millis(2)).await;
            }
        });
    });
    address.recv().unwrap()
}

fn trifacet(args: &[&str]) -> Command {
    let mut command = testkit::trifacet(&["watch"]);
    command.args(args);
    command
}

fn run(args: &[&str]) -> (Output, String, String) {
    let output = trifacet(args).output().unwrap();
    let [out, err] = [&output.stdout, &output.stderr].map(|b| String::from_utf8(b.clone()).unwrap());
    (output, out, err)
}

#[test]
fn json_contains_every_frame_with_null_for_unknown_numbers() {
    let (output, out, err) = run(&[&format!("tcp://{}", serve()), "--format", "json", "--count", "25"]);
    assert!(output.status.success(), "{err}");
    let rows: Vec<serde_json::Value> = out.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(rows.len(), 25);
    let first = rows[0]["sequence"].as_u64().unwrap();
    for (row, sequence) in rows.iter().zip(first..) {
        assert_eq!(row["sequence"], sequence);
        let valid = sequence % 10 != 9;
        assert_eq!(row["tx_m"].is_number(), valid, "{row}");
        assert_eq!(row["tx_m"].is_null(), !valid, "{row}");
        assert_eq!(row["status"][0], if valid { "POSE_VALID" } else { "PSD_B_LOW" });
    }
}

#[test]
fn csv_contains_a_header_and_every_frame() {
    let (output, out, err) = run(&[&format!("tcp://{}", serve()), "--format=csv", "--count=12"]);
    assert!(output.status.success(), "{err}");
    let lines: Vec<Vec<&str>> = out.lines().map(|l| l.split(',').collect()).collect();
    assert_eq!(lines.len(), 13);
    let column = |name: &str| lines[0].iter().position(|n| *n == name).unwrap();
    let (sequence, yaw) = (column("sequence"), column("yaw_rad"));
    for line in &lines[1..] {
        assert_eq!(line.len(), lines[0].len());
        let valid = line[sequence].parse::<u64>().unwrap() % 10 != 9;
        assert_eq!(line[yaw].parse::<f64>().is_ok(), valid, "{line:?}");
        assert_eq!(line[yaw].is_empty(), !valid, "{line:?}");
    }
}

#[test]
fn text_output_is_decimated_and_keeps_all_status_bits() {
    let (output, out, err) = run(&[&format!("tcp://{}", serve()), "--count", "3"]);
    assert!(output.status.success(), "{err}");
    let lines: Vec<&str> = out.lines().collect();
    assert!(lines[0].contains("at most five frames a second"), "{out}");
    let rows = &lines[2..];
    assert_eq!(rows.len(), 3, "{out}");
    let sequence = |row: &str| row.split_whitespace().next().unwrap().parse::<u64>().unwrap();
    assert!(sequence(rows[1]) > sequence(rows[0]) + 10, "{out}");
    assert!(rows[1].contains("POSE_VALID") && rows[1].contains("PSD_B_LOW"), "{out}");
}

#[test]
fn a_closed_pipe_ends_the_command_without_an_error() {
    let mut child = trifacet(&[&format!("tcp://{}", serve()), "--format", "json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{:?}", output.status);
    assert_eq!(String::from_utf8(output.stderr).unwrap(), "");
}

#[test]
fn watch_waits_for_datagrams_and_prints_them() {
    // The port is free: it has just been closed.
    let to = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut child = trifacet(&[&format!("udp://{to}"), "--format", "json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut note = String::new();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    stderr.read_line(&mut note).unwrap();
    assert!(note.contains("still waiting"), "{note}");
    let (stop, stopped) = std::sync::mpsc::channel::<()>();
    let sender = std::thread::spawn(move || {
        for sequence in 0.. {
            let _ = socket.send_to(&frame(sequence).encode(), to);
            if stopped.recv_timeout(Duration::from_millis(5))
                != Err(std::sync::mpsc::RecvTimeoutError::Timeout)
            {
                return;
            }
        }
    });
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    assert!(child.wait().unwrap().success());
    drop(stop);
    sender.join().unwrap();
    let row: serde_json::Value = serde_json::from_str(&line).unwrap();
    assert_eq!(row["session"], 11);
}

#[test]
fn a_missing_daemon_is_reported_clearly() {
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let (output, _, err) = run(&[&format!("tcp://{free}")]);
    assert_eq!(output.status.code(), Some(exit::UNAVAILABLE.into()), "{err}");
    assert!(err.contains(&free.to_string()) && err.contains("trifacet run"), "{err}");

    // The first line is a note, since frames may be rare.
    let (output, _, err) = run(&["udp://127.0.0.1:0", "--count", "1"]);
    assert_eq!(output.status.code(), Some(exit::UNAVAILABLE.into()), "{err}");
    let lines: Vec<_> = err.lines().collect();
    let [note, end] = lines[..] else { panic!("{err}") };
    assert!(note.contains("no frame for 3 s") && note.ends_with("still waiting"), "{err}");
    assert!(end.contains("no frame for 65 s") && end.contains("[publishing] udp"), "{err}");

    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let (output, _, err) = run(&[&format!("udp://{}", taken.local_addr().unwrap())]);
    assert_eq!(output.status.code(), Some(exit::IN_USE.into()), "{err}");
    assert!(err.contains("another process"), "{err}");
}
