//! The text protocol of TCP clients.

use std::net::SocketAddr;
use std::time::Duration;

use serde_json::Value;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio::time::timeout;
use trifacet::client::{Client, Message, Options, Pace, PoseFrame};
use trifacet::publishing::tcp::Limits;
use trifacet_wire::Status;

use super::fixture::{Server, frame, start};
use crate::testkit::PATIENCE;

/// A client of the text protocol.
struct Talk(BufReader<TcpStream>);

impl Talk {
    async fn to(address: SocketAddr) -> Self {
        Self(BufReader::new(TcpStream::connect(address).await.unwrap()))
    }

    async fn say(&mut self, bytes: &str) {
        self.0.write_all(bytes.as_bytes()).await.unwrap();
    }

    /// The next line without its line feed; `None` at the end of the stream.
    async fn hear(&mut self) -> Option<String> {
        let mut line = String::new();
        let n = timeout(PATIENCE, self.0.read_line(&mut line)).await.expect("a line in time").unwrap();
        (n > 0).then(|| line.trim_end().to_owned())
    }

    async fn ask(&mut self, line: &str) -> String {
        self.say(&format!("{line}\n")).await;
        self.hear().await.expect("an answer")
    }

    async fn json(&mut self) -> Value {
        serde_json::from_str(&self.hear().await.unwrap()).unwrap()
    }
}

/// A frame without a pose.
fn dark(sequence: u64) -> PoseFrame {
    let status = Status::PSD_A_LOW;
    PoseFrame { status, pose: [f64::NAN; 6], deviations: [f32::NAN; 6], ..frame(sequence) }
}

fn posed(sequence: u64) -> PoseFrame {
    PoseFrame { pose: [1e-6, -0.25, 3e-6, 4e-6, 5e-6, 1.0 / 3.0], ..frame(sequence) }
}

/// Sends a frame, and waits until the server has it as the newest one.
async fn publish(server: &Server, talk: &mut Talk, frame: PoseFrame) {
    server.frames.send(frame).await.unwrap();
    let sequence = format!(" sequence={} ", frame.sequence);
    while !talk.ask("status?").await.contains(&sequence) {}
}

fn value<'a>(line: &'a str, key: &str) -> &'a str {
    let found = line.split(' ').find_map(|pair| pair.strip_prefix(key)?.strip_prefix('='));
    found.unwrap_or_else(|| panic!("{line} does not contain {key}"))
}

/// Requests the pose until it is too old to be valid; it is valid up to an age of one second.
async fn old(talk: &mut Talk) -> String {
    let old = async {
        loop {
            let line = talk.ask("pose?").await;
            if value(&line, "valid") == "0" {
                return line;
            }
            assert!(value(&line, "age_s").parse::<f64>().unwrap() <= 1.0, "{line}");
        }
    };
    timeout(PATIENCE, old).await.expect("the pose becomes invalid")
}

#[tokio::test]
async fn readers_of_json_get_the_time_to_the_nanosecond() {
    const TIME_NS: i64 = 1_795_262_400_123_456_789;
    let server = start(Limits::default()).await;
    let mut frames = Vec::new();
    for fields in ["", " fields=time_ns", " fields=sequence"] {
        let mut talk = Talk::to(server.address).await;
        talk.say(&format!("stream format=json{fields}\n")).await;
        assert!(talk.json().await["descriptor"].is_object());
        assert!(talk.json().await["heartbeat"].is_object());
        server.frames.send(PoseFrame { time_ns: TIME_NS, ..posed(1) }).await.unwrap();
        let json = loop {
            let json = talk.json().await;
            if json["heartbeat"].is_null() {
                break json;
            }
        };
        frames.push(json);
    }
    for json in &frames[..2] {
        assert_eq!(json["time_ns"], TIME_NS, "{json}");
        assert_eq!(json["time_ns_text"], TIME_NS.to_string());
        // A reader with 64-bit floating point.
        assert_ne!(json["time_ns"].as_f64().unwrap() as i64, TIME_NS);
    }
    assert_eq!(frames[1].as_object().unwrap().len(), 2, "{}", frames[1]);
    assert_eq!(frames[2].as_object().unwrap().len(), 1, "{}", frames[2]);
}

#[tokio::test]
async fn a_byte_order_mark_before_the_first_request_is_accepted() {
    let server = start(Limits::default()).await;
    let mut talk = Talk::to(server.address).await;
    let answer = talk.ask("\u{feff}help").await;
    assert!(answer.starts_with("stream "), "{answer}");
    let mut talk = Talk::to(server.address).await;
    talk.say("\u{feff}stream format=json\n").await;
    assert!(talk.json().await["descriptor"].is_object());
}

#[tokio::test]
async fn queries_return_the_newest_pose_and_never_an_old_one_as_valid() {
    let server = start(Limits::default()).await;
    let mut talk = Talk::to(server.address).await;
    assert!(talk.ask("pose?").await.starts_with("error: no frame has been made yet"));
    publish(&server, &mut talk, posed(7)).await;
    let line = talk.ask("POSE?\r").await;
    assert!(line.is_ascii());
    assert_eq!(value(&line, "valid"), "1");
    assert_eq!(value(&line, "tx_m").parse::<f64>(), Ok(1e-6));
    assert_eq!(value(&line, "yaw_rad").parse::<f64>(), Ok(1.0 / 3.0), "all digits are present");
    assert_eq!((value(&line, "lock"), value(&line, "status")), ("off", "0x00000001"));
    assert!((0.0..60.0).contains(&value(&line, "age_s").parse::<f64>().unwrap()));
    // The daemon is stalled: its last pose is no longer valid.
    let line = old(&mut talk).await;
    assert_eq!((value(&line, "valid"), value(&line, "tx_m"), value(&line, "sequence")), ("0", "nan", "7"));
    assert!(value(&line, "age_s").parse::<f64>().unwrap() > 1.0);
    publish(&server, &mut talk, dark(8)).await;
    let line = talk.ask("pose?").await;
    assert_eq!((value(&line, "valid"), value(&line, "pitch_rad")), ("0", "nan"));
    let line = talk.ask("status?").await;
    assert_eq!((value(&line, "bits"), value(&line, "session")), ("PSD_A_LOW", "0x0000000b"));
    let descriptor: Value = serde_json::from_str(&talk.ask("descriptor?").await).unwrap();
    assert_eq!(descriptor["descriptor"]["rate_hz"], 1000.0);
    assert!(talk.ask("help").await.contains("stream [format=binary|json|csv]"));
    assert!(talk.ask("stream fields=tx_m").await.starts_with("error: "));
    talk.say("bye\n").await;
    assert_eq!(talk.hear().await, None);
}

#[tokio::test]
async fn each_client_gets_its_own_format_divider_and_fields() {
    let server = start(Limits::default()).await;
    let mut json = Talk::to(server.address).await;
    let mut csv = Talk::to(server.address).await;
    json.say("stream format=json rate_hz=240 fields=sequence,tx_m,status,sd_tx_m held=on\n").await;
    csv.say("stream format=csv divider=3 fields=ty_m,sequence\n").await;
    let descriptor = json.json().await["descriptor"].take();
    assert_eq!(
        (&descriptor["stream"]["divider"], &descriptor["stream"]["rate_hz"]),
        (&4.into(), &250.0.into())
    );
    assert!(json.json().await["heartbeat"]["sent"].is_number());
    assert!(csv.hear().await.unwrap().starts_with("# descriptor {"));
    assert_eq!(csv.hear().await.unwrap(), "ty_m,sequence");
    assert!(csv.hear().await.unwrap().starts_with("# heartbeat {"));
    for sequence in 0..13 {
        let frame = if sequence < 6 { posed(sequence) } else { dark(sequence) };
        server.frames.send(frame).await.unwrap();
    }
    for sequence in [0, 4, 8, 12] {
        let row = json.json().await;
        assert_eq!((&row["sequence"], row["tx_m"].as_f64()), (&sequence.into(), Some(1e-6)), "held: {row}");
        let held = row["status"].as_array().unwrap().contains(&"POSE_HELD".into());
        assert_eq!((held, row["sd_tx_m"].is_null()), (sequence >= 8, sequence >= 8), "{row}");
    }
    let rows = ["-2.5000000000000000e-1,0", "-2.5000000000000000e-1,3", ",6", ",9", ",12"];
    for row in rows {
        assert_eq!(csv.hear().await.unwrap(), row);
    }
    // Queries and errors do not end a stream, and another request changes it.
    let answer: Value = serde_json::from_str(&json.ask("pose?").await).unwrap();
    assert!(answer["answer"].as_str().unwrap().starts_with("valid=0"), "{answer}");
    assert!(csv.ask("stream divider=0").await.starts_with("# answer \"error: "));
    csv.say("stream format=json fields=sequence\n").await;
    assert_eq!(csv.json().await["descriptor"]["stream"]["format"], "json");
    assert_eq!(csv.json().await["heartbeat"]["sent"], 5);
    server.frames.send(dark(13)).await.unwrap();
    assert_eq!(csv.json().await, serde_json::json!({ "sequence": 13 }));
}

#[tokio::test]
async fn a_binary_stream_supports_held_poses_a_divider_and_answers() {
    let server = start(Limits::default()).await;
    let endpoint = format!("tcp://{}", server.address).parse().unwrap();
    let options = Options { pace: Pace::Divider(5), held: true, ..Options::default() };
    let mut client = Client::connect_with(&endpoint, options).await.unwrap();
    let mut raw = TcpStream::connect(server.address).await.unwrap();
    raw.write_all(b"stream divider=1000\npose?\n").await.unwrap();
    for _ in 0..2 {
        timeout(PATIENCE, client.next()).await.unwrap().unwrap(); // descriptor, heartbeat
    }
    for sequence in 0..10 {
        server.frames.send(if sequence < 3 { posed(sequence) } else { dark(sequence) }).await.unwrap();
    }
    let mut frames = Vec::new();
    while frames.len() < 2 {
        if let Message::Pose(frame) = timeout(PATIENCE, client.next()).await.unwrap().unwrap() {
            frames.push(frame);
        }
    }
    assert_eq!([frames[0].sequence, frames[1].sequence], [0, 5]);
    assert_eq!(frames[1].pose, posed(0).pose);
    assert_eq!(frames[1].status, Status::PSD_A_LOW | Status::POSE_HELD);
    assert!(frames[1].deviations.iter().all(|d| *d == f32::INFINITY));
    assert_eq!(client.losses().missed_frames, 0, "a divided sequence has no gaps");

    let mut decoder = trifacet_wire::stream::Decoder::default();
    loop {
        match decoder.next_message() {
            Some(Ok(Message::Answer(answer))) => {
                assert!(answer.0.contains("error: no frame") || answer.0.starts_with("valid="), "{answer:?}");
                break;
            }
            Some(other) => drop(other.unwrap()),
            None => assert_ne!(timeout(PATIENCE, raw.read_buf(decoder.room())).await.unwrap().unwrap(), 0),
        }
    }
    assert_eq!(decoder.skipped(), 0);
}

#[tokio::test]
async fn clients_without_a_complete_line_are_disconnected_and_streaming_clients_may_be_silent() {
    let idle = Duration::from_millis(300);
    let server = start(Limits { idle, ..Limits::default() }).await;
    let mut half = Talk::to(server.address).await;
    let mut none = Talk::to(server.address).await;
    let mut stream = Talk::to(server.address).await;
    stream.say("stream format=json\n").await;
    half.say("strea").await;
    for talk in [&mut half, &mut none] {
        assert!(talk.hear().await.unwrap().starts_with("error: no complete line for 0.3 s"));
        assert_eq!(talk.hear().await, None);
    }
    // A heartbeat a second later: the client is still served.
    let beats = async {
        loop {
            if stream.json().await["heartbeat"].is_object() {
                return;
            }
        }
    };
    beats.await;
    stream.0.get_mut().shutdown().await.unwrap();
    server.frames.send(frame(3)).await.unwrap();
    while stream.json().await["sequence"] != 3 {}
}

#[tokio::test]
async fn only_allowed_networks_are_accepted() {
    let allow = vec!["10.0.0.0/8".parse().unwrap()];
    let server = start(Limits { allow, ..Limits::default() }).await;
    let mut talk = Talk::to(server.address).await;
    talk.say("stream\n").await;
    assert_eq!(
        talk.hear().await.unwrap(),
        "error: 127.0.0.1 is in none of the networks of [publishing] allow"
    );
    assert_eq!(talk.hear().await, None);
    assert_eq!(server.counters.tcp_refused.get(), 1);
}
