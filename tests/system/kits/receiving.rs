//! The kits as receivers of a running daemon, and of a stream with every kind of loss.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, UdpSocket};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

use serde_json::Value;
use trifacet::client::PoseFrame;
use trifacet_wire::message::Kind;
use trifacet_wire::stream::{Decoder, json};

use super::fixture::{daemon, datagrams, receive};
use super::tools::{compile, python, python_of, succeeded};
use crate::testkit::{Killed, PATIENCE, Udp};

/// A running program of a kit with its port open.
struct Receiver {
    process: Killed,
    output: BufReader<std::process::ChildStdout>,
    port: u16,
}

impl Receiver {
    /// The number at the end of its first line is the port.
    fn start(command: &mut Command) -> Self {
        let mut process = Killed(command.stdout(Stdio::piped()).spawn().unwrap());
        let mut output = BufReader::new(process.0.stdout.take().unwrap());
        let mut line = String::new();
        output.read_line(&mut line).unwrap();
        let port = line.trim().rsplit(' ').next().unwrap().parse().unwrap();
        Self { process, output, port }
    }

    fn python(kind: &str, port: u16, count: usize, divider: u32) -> Self {
        let arguments = [kind.to_owned(), port.to_string(), count.to_string(), divider.to_string()];
        Self::start(python("tests/system/kits/receive.py").args(arguments))
    }

    /// The last line of the output, after the end of the program.
    fn last_line(mut self) -> String {
        let mut text = String::new();
        self.output.read_to_string(&mut text).unwrap();
        let status = self.process.0.wait().unwrap();
        assert!(status.success(), "{status}: {text}");
        text.lines().last().unwrap().to_owned()
    }

    fn told(self) -> Value {
        serde_json::from_str(&self.last_line()).unwrap()
    }
}

/// The number from an entry such as "missed=3" in a line of the C receiver.
fn number(line: &str, name: &str) -> u64 {
    let found = line.split(' ').find_map(|word| word.strip_prefix(name)?.strip_prefix('='));
    found.unwrap_or_else(|| panic!("no {name} in {line}")).parse().unwrap()
}

fn valid(datagrams: &[Vec<u8>]) -> u64 {
    datagrams.iter().filter(|d| PoseFrame::decode(d).unwrap().status.0 & 1 != 0).count() as u64
}

#[test]
fn all_frames_of_a_daemon_arrive_over_udp() {
    let udp = Udp::open();
    let (_place, receiver) = compile("clients/c/udp_receiver.c", &[]);
    let (_place_2, trusting) = compile("clients/c/udp_receiver.c", &["-DTRIFACET_NOT_REAL=0"]);
    let c = [receiver, trusting].map(|path| Receiver::start(Command::new(path).args(["0", "600"])));
    let py = Receiver::python("udp", 0, 600, 1);
    let _daemon = daemon(&[udp.address().port(), py.port, c[0].port, c[1].port]);
    let beside = receive(&udp, 600);
    let valid = valid(&beside);
    let first = PoseFrame::decode(&beside[0]).unwrap().sequence;

    let told = py.told();
    assert_eq!(told["sequences"].as_array().unwrap().len(), 600);
    assert_eq!(told["sequences"][0], first);
    assert_eq!([&told["missed"], &told["late"], &told["damaged"]].map(Value::as_u64), [Some(0); 3], "{told}");
    assert_eq!(told["valid"], valid);
    assert_eq!(
        (&told["usable"], &told["simulated"]),
        (&0.into(), &valid.into()),
        "simulated frames are not usable"
    );
    assert_eq!(told["future"], 0, "sender and receiver have the same clock");

    let [strict, trusting] = c.map(Receiver::last_line);
    for line in [&strict, &trusting] {
        let told = ["frames", "valid", "missed", "late", "refused"].map(|name| number(line, name));
        assert_eq!(told, [600, valid, 0, 0, 0], "{line}");
    }
    assert_eq!(number(&strict, "usable"), 0);
    // On a busy machine, some frames exceed the age limit of 20 ms, but not all.
    assert!((1..=valid).contains(&number(&trusting, "usable")), "{trusting}");
}

/// Real frames, with losses, a repetition, one frame out of order, and damage.
fn troubled() -> Vec<Vec<u8>> {
    let mut sent = datagrams()[..100].to_vec();
    sent.swap(50, 51);
    sent.insert(41, sent[40].clone());
    sent[30][100] ^= 1;
    sent[31].push(0);
    sent.insert(25, b"hello".to_vec());
    sent.drain(10..13);
    sent
}

/// Sends the datagrams slowly enough for any receive buffer.
fn send(datagrams: &[Vec<u8>], port: u16) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    for datagram in datagrams {
        socket.send_to(datagram, ("127.0.0.1", port)).unwrap();
        sleep(Duration::from_millis(1));
    }
}

#[test]
fn losses_are_counted_and_damage_is_refused() {
    // Of 100 frames: three dropped, two damaged; one twice; one overtaken, which counts as missed and as
    // late.
    let (_place, program) = compile("clients/c/udp_receiver.c", &[]);
    let (py, c) =
        (Receiver::python("udp", 0, 94, 1), Receiver::start(Command::new(program).args(["0", "94"])));
    for port in [py.port, c.port] {
        send(&troubled(), port);
    }
    let told = py.told();
    assert_eq!([&told["missed"], &told["late"]].map(Value::as_u64), [Some(6), Some(2)], "{told}");
    assert_eq!(told["damaged"], 5 + 192 + 193);
    let sequences: Vec<_> =
        told["sequences"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).collect();
    assert!(sequences.is_sorted(), "only newer frames are returned");
    let line = c.last_line();
    assert_eq!(["frames", "missed", "late", "refused"].map(|n| number(&line, n)), [94, 6, 2, 3], "{line}");
}

#[test]
fn a_divider_is_no_loss() {
    let first = PoseFrame::decode(&datagrams()[0]).unwrap().sequence;
    let wanted = |d: &&Vec<u8>| PoseFrame::decode(d).unwrap().sequence.is_multiple_of(5);
    let mut sent: Vec<Vec<u8>> = datagrams()[..100].iter().filter(wanted).cloned().collect();
    sent.remove(10);
    let py = Receiver::python("udp", 0, 19, 5);
    send(&sent, py.port);
    let told = py.told();
    assert_eq!((&told["missed"], &told["late"]), (&1.into(), &0.into()), "{told}");
    assert_eq!(told["sequences"][0], first.next_multiple_of(5));
}

#[test]
fn all_requested_frames_arrive_over_tcp() {
    let mut daemon = daemon(&[]);
    let told = Receiver::python("tcp", daemon.address().port(), 200, 4).told();
    let sequences: Vec<_> =
        told["sequences"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).collect();
    assert_eq!(sequences.len(), 200);
    let first = sequences[0];
    assert!(first.is_multiple_of(4));
    assert!(sequences.iter().zip(0..).all(|(s, n)| *s == first + 4 * n), "{sequences:?}");
    assert_eq!([&told["missed"], &told["late"], &told["damaged"]].map(Value::as_u64), [Some(0); 3], "{told}");
    assert_eq!(told["descriptor"]["stream"]["divider"], 4);
    assert_eq!(told["heartbeat"]["dropped"], 0);
    let valid = told["valid"].as_u64().unwrap();
    assert!(0 < valid && valid < 200, "with and without light: {valid}");
}

#[test]
fn the_python_kit_of_0_1_0_reads_the_stream() {
    let mut daemon = daemon(&[]);
    let port = daemon.address().port().to_string();
    let mut kit = python_of("tests/fixtures/0.1.0", "tests/system/kits/receive.py");
    let told = Receiver::start(kit.args(["tcp", &port, "200", "4"])).told();
    assert_eq!(told["sequences"].as_array().unwrap().len(), 200);
    assert_eq!([&told["missed"], &told["late"], &told["damaged"]].map(Value::as_u64), [Some(0); 3], "{told}");
    assert_eq!(told["descriptor"]["stream"]["divider"], 4);
    assert!(told["valid"].as_u64().unwrap() > 0, "{told}");
}

/// A server that expects the request of the Python kit, sends these bytes and closes. Returns the output of
/// the kit.
fn over_tcp(bytes: &[u8]) -> Value {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let receiver = Receiver::python("tcp", listener.local_addr().unwrap().port(), 1000, 1);
    receiver.serve(&listener, bytes)
}

impl Receiver {
    fn serve(self, listener: &TcpListener, bytes: &[u8]) -> Value {
        let (stream, _) = listener.accept().unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut line = String::new();
        BufReader::new(&stream).read_line(&mut line).unwrap();
        assert_eq!(line, "stream format=binary divider=1\n");
        for piece in bytes.chunks(100) {
            (&stream).write_all(piece).unwrap();
        }
        drop(stream);
        self.told()
    }
}

#[test]
fn after_damage_in_a_tcp_stream_the_next_message_is_found() {
    let mut unknown = json(Kind::Heartbeat, &"of a later version").unwrap();
    unknown[..4].copy_from_slice(b"TFX1");
    let at = unknown.len() - 4;
    let crc = crc32fast::hash(&unknown[..at]);
    unknown[at..].copy_from_slice(&crc.to_le_bytes());

    let mut bytes = b"T TF\0\0\x01\0\x08\0 junk".to_vec();
    for (n, datagram) in datagrams()[..60].iter().enumerate() {
        match n {
            7 => bytes.extend(&datagram[..90]),
            20 => bytes.extend(&unknown),
            _ => bytes.extend(datagram),
        }
        if n == 33 {
            bytes.extend([0x54; 300]);
        }
    }
    let mut rust = Decoder::default();
    rust.push(&bytes);
    let mut frames = 0;
    while let Some(message) = rust.next_message() {
        message.unwrap();
        frames += 1;
    }
    assert_eq!(frames, 58);
    let told = over_tcp(&bytes);
    assert_eq!(told["sequences"].as_array().unwrap().len(), frames);
    assert_eq!((&told["damaged"], &told["missed"]), (&rust.skipped().into(), &2.into()), "{told}");
    assert_eq!(told["end"], "Closed: the daemon closed the stream");
}

#[test]
fn a_refusal_is_reported_with_the_message_of_the_daemon() {
    let told = over_tcp(b"error: 192.168.1.9 is not in [publishing] allow\n");
    assert_eq!(told["end"], "Closed: error: 192.168.1.9 is not in [publishing] allow");
    let refusal = json(Kind::Refusal, &serde_json::json!({"error": "busy"})).unwrap();
    assert_eq!(over_tcp(&refusal)["end"], "Closed: busy");
    let mut other = datagrams()[0].clone();
    other[4] = 2;
    let crc = crc32fast::hash(&other[..188]);
    other[188..].copy_from_slice(&crc.to_le_bytes());
    let told = over_tcp(&other);
    assert!(
        told["end"].as_str().unwrap().starts_with("VersionError: the daemon speaks version 2.1"),
        "{told}"
    );
}

#[test]
fn the_python_example_shows_poses() {
    let mut daemon = daemon(&[]);
    let port = daemon.address().port().to_string();
    let mut command = python("clients/python/example.py");
    let mut example =
        Killed(command.args(["tcp", "127.0.0.1", &port]).stdout(Stdio::piped()).spawn().unwrap());
    let lines = BufReader::new(example.0.stdout.take().unwrap()).lines().map(Result::unwrap);
    let mut seen = (false, false);
    for line in lines.take_while(|_| true) {
        seen.0 |= line.contains("um, urad");
        seen.1 |= line.starts_with("no pose: PSD_A_LOW PSD_B_LOW PSD_C_LOW");
        if seen == (true, true) {
            return;
        }
    }
    panic!("the example ended");
}

#[test]
fn silence_is_reported_and_reading_can_continue() {
    let script = "import socket, sys, trifacet\n\
                  stream = trifacet.udp(0, silence=0.1)\n\
                  try:\n    next(stream)\n    sys.exit('a frame without a sender')\n\
                  except trifacet.Silence as e:\n    assert '[publishing] udp' in str(e), e\n\
                  frame = bytes(map(int, sys.argv[1:]))\n\
                  stream.silence = 60\n\
                  socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(frame, ('127.0.0.1', stream.port))\n\
                  assert next(stream).valid\n";
    let good = datagrams().iter().find(|d| d[48] & 1 == 1).unwrap();
    let mut command = Command::new("python3");
    command
        .env("PYTHONPATH", super::tools::root("clients/python"))
        .args(["-c", script])
        .args(good.iter().map(u8::to_string));
    succeeded(&mut command, "silence");
}

#[test]
fn a_udp_reader_waits_for_rare_frames_and_then_notices_that_they_end() {
    let script = "import json, socket, sys, threading, time, trifacet\n\
                  stream = trifacet.udp(0)\n\
                  out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n\
                  def send():\n    for frame in sys.argv[1:]:\n        time.sleep(1.5)\n        \
                  out.sendto(bytes(json.loads(frame)), ('127.0.0.1', stream.port))\n\
                  threading.Thread(target=send).start()\n\
                  for _ in sys.argv[1:]:\n    next(stream)\n\
                  try:\n    next(stream)\n    sys.exit('a frame without a sender')\n\
                  except trifacet.Silence as e:\n    assert 'no frame' in str(e), e\n";
    let mut command = Command::new("python3");
    command
        .env("PYTHONPATH", super::tools::root("clients/python"))
        .args(["-c", script])
        .args(datagrams().iter().take(3).map(|datagram| format!("{datagram:?}")));
    succeeded(&mut command, "rare frames");
}
