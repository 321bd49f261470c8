//! The socket of the page: cost of viewers, and admission.

use std::io::Read;
use std::net::{SocketAddr, TcpStream};

use serde_json::Value;
use tungstenite::client::IntoClientRequest;
use tungstenite::error::Error;
use tungstenite::{Message, WebSocket};

use super::daemon;
use crate::testkit::{PATIENCE, wait_for};

type Socket = WebSocket<TcpStream>;

pub(crate) fn connect(at: SocketAddr, origin: Option<&str>) -> Result<Socket, Option<u16>> {
    let mut request = format!("ws://{at}/live").into_client_request().unwrap();
    if let Some(origin) = origin {
        request.headers_mut().insert("Origin", origin.parse().unwrap());
    }
    let stream = TcpStream::connect(at).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    match tungstenite::client(request, stream) {
        Ok((socket, _)) => Ok(socket),
        Err(tungstenite::HandshakeError::Failure(Error::Http(answer))) => Err(Some(answer.status().as_u16())),
        Err(_) => Err(None),
    }
}

/// The next message of this kind.
fn next(socket: &mut Socket, kind: &str) -> Value {
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            let message: Value = serde_json::from_str(&text).unwrap();
            if !message[kind].is_null() {
                return message[kind].clone();
            }
        }
    }
}

fn watch(socket: &mut Socket, span_s: u32) -> Value {
    socket.send(Message::text(format!("{{\"watch\": {span_s}}}"))).unwrap();
    next(socket, "history")
}

#[test]
fn history_and_updates_contain_every_sample_once_at_ten_kilohertz() {
    let (_daemon, mut stream, at) = daemon("acquisition.rate_hz = 10000\npublishing.tcp_queue = 65536\n");
    let first = stream.locked();
    let mut socket = connect(at, None).unwrap();
    next(&mut socket, "hello");
    let mut frames = vec![first];
    frames.extend(stream.take(20_000)); // a history of two seconds
    let history = watch(&mut socket, 10);
    let through = history["through"].as_i64().unwrap();
    let mut bins: Vec<Value> = history["bins"].as_array().unwrap().clone();
    let mut explained = false;
    for _ in 0..20 {
        let update = next(&mut socket, "update");
        let [number, text] = ["time_ns", "time_ns_text"].map(|name| &update["frame"][name]);
        assert_eq!(text.as_str().unwrap().parse().ok(), number.as_i64(), "{update}");
        // Around a change, the cause may belong to another state than the newest frame.
        let lock = &update["lock"];
        assert!(lock.is_null() || lock["lock"] == update["frame"]["lock"], "{update}");
        explained |= lock["cause"] == "offset_within_limit";
        let news = update["bins"].as_array().unwrap();
        bins.extend(news.iter().filter(|bin| bin[0].as_i64().unwrap() > through).cloned());
    }
    assert!(explained, "no update has the cause of the lock");
    let from = first.time_ns.div_euclid(20_000_000) + 1;
    bins.retain(|bin| bin[0].as_i64().unwrap() >= from);
    let last = bins.last().unwrap()[0].as_i64().unwrap();
    // The same frames from the stream.
    frames.extend(stream.through("the last one", |f| f.time_ns.div_euclid(20_000_000) > last));
    assert_eq!(bins.len() as i64, last - from + 1, "an interval is missing or repeated");
    let mut worst = 0.0_f64;
    for bin in &bins {
        let k = bin[0].as_i64().unwrap();
        let of = frames.iter().filter(|f| f.valid() && f.time_ns.div_euclid(20_000_000) == k);
        assert_eq!(of.clone().count() as u64, bin[1].as_u64().unwrap(), "poses in {k}");
        for axis in 0..6 {
            let (min, max) =
                of.clone().map(|f| f.pose[axis]).fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
            let told = |i: usize| bin[2 + 3 * axis + i].as_f64().unwrap();
            worst = worst.max((told(0) - min).abs()).max((told(1) - max).abs());
            assert!(told(0) <= told(2) && told(2) <= told(1));
        }
    }
    assert!(worst < 1e-10, "a minimum or maximum is off by {worst}");
    let counters = stream.heartbeat().counters;
    assert_eq!((counters["monitor_overflows"], counters["page_skips"]), (0, 0));
}

#[test]
fn a_stalled_viewer_delays_no_other_one_and_its_missed_updates_are_reported() {
    let (_daemon, mut stream, at) = daemon("acquisition.rate_hz = 2000\n");
    stream.locked();
    let mut slow = connect(at, None).unwrap();
    watch(&mut slow, 21_600);
    let mut quick = connect(at, None).unwrap();
    watch(&mut quick, 10);
    let mut numbers = vec![];
    for _ in 0..40 {
        // It requests far more than the buffers hold, and reads nothing.
        slow.get_ref().set_nonblocking(true).unwrap();
        for _ in 0..30 {
            let _ = slow.send(Message::text("{\"watch\": 10}"));
        }
        numbers.push(next(&mut quick, "update")["number"].as_u64().unwrap());
    }
    assert!(
        numbers.windows(2).all(|pair| pair[1] == pair[0] + 1),
        "the other viewer missed updates: {numbers:?}"
    );
    slow.get_ref().set_nonblocking(false).unwrap();
    let missed = next(&mut slow, "missed").as_u64().unwrap();
    stream.skip_to_now();
    let counters = stream.heartbeat().counters;
    assert!(missed > 0 && counters["page_skips"] >= missed, "{missed}: {counters:?}");
    assert_eq!(counters["monitor_overflows"], 0);
}

#[test]
fn other_sites_are_refused_and_invalid_messages_close_a_socket() {
    let (_daemon, mut stream, at) = daemon("");
    let port = at.port();
    assert!(connect(at, Some(&format!("http://{at}"))).is_ok());
    for bad in ["http://evil.example", "http://127.0.0.1:1", "null", &format!("http://localhost:{port}")] {
        assert_eq!(connect(at, Some(bad)).err(), Some(Some(403)), "{bad}");
    }
    for nonsense in ["", "{\"watch\": -1}", "{\"pause\": false}", "[]", "watch", &"x".repeat(300)] {
        let mut socket = connect(at, None).unwrap();
        socket.send(Message::text(nonsense)).unwrap();
        while socket.read().is_ok() {}
        let mut rest = Vec::new();
        let _ = socket.get_mut().read_to_end(&mut rest); // returns when the socket is closed
    }
    stream.skip_to_now();
    assert_eq!(stream.heartbeat().counters["monitor_forbidden"], 4);
}

#[test]
fn the_number_of_viewers_is_limited_and_places_become_free_again() {
    let (_daemon, mut stream, at) = daemon("");
    let mut viewers: Vec<_> = (0..64).map(|_| connect(at, None).unwrap()).collect();
    assert_eq!(connect(at, None).err(), Some(Some(503)));
    stream.skip_to_now();
    assert_eq!(stream.heartbeat().counters["monitor_refused"], 1);
    viewers.clear();
    wait_for("a free place", || connect(at, None).map(drop).map_err(|code| format!("{code:?}")));
}
