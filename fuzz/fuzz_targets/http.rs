//! Bytes on a connection to the monitor: requests, and messages on a WebSocket. Each connection ends, each answer is one
//! of HTTP, and afterwards the server serves the next one.

#![no_main]

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use tokio::sync::{mpsc, watch};
use trifacet::condition::Condition;
use trifacet::config::{Config, RecordingMode};
use trifacet::doubts;
use trifacet::monitor::host_filter::Hosts;
use trifacet::monitor::http;
use trifacet::monitor::view::{Sources, View};
use trifacet::publishing::StreamId;
use trifacet::publishing::descriptor::StreamFacts;
use trifacet::recording::handle::State;

fuzz_target!(|bytes: &[u8]| {
    let at = *server();
    let (kind, rest) = bytes.split_first().unwrap_or((&0, &[]));
    let answer = match kind % 3 {
        // The bytes as they are, as the end of a request, and as messages of a viewer: the fuzzer cannot guess the rest.
        0 => ask(at, rest, true),
        1 => ask(at, &[format!("GET / HTTP/1.1\r\nHost: {at}\r\n").as_bytes(), rest].concat(), true),
        _ => ask(at, &[upgrade(at).as_bytes(), rest].concat(), true),
    };
    assert!(answer.is_empty() || answer.starts_with(b"HTTP/1."), "{answer:?}");
    let health = ask(at, format!("GET /healthz HTTP/1.1\r\nHost: {at}\r\nConnection: close\r\n\r\n").as_bytes(), false);
    assert!(health.starts_with(b"HTTP/1.1 "), "no answer: {health:?}");
});

fn upgrade(at: SocketAddr) -> String {
    format!(
        "GET /live HTTP/1.1\r\nHost: {at}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    )
}

/// Sends the bytes and may then close this side, which also ends a request in progress; returns what arrives until the
/// other side is closed.
fn ask(at: SocketAddr, bytes: &[u8], close: bool) -> Vec<u8> {
    let mut stream = TcpStream::connect(at).expect("the server accepts");
    stream.set_read_timeout(Some(Duration::from_secs(20))).expect("a time limit");
    // It may be refused before its end.
    let _ = stream.write_all(bytes);
    if close {
        let _ = stream.shutdown(Shutdown::Write);
    }
    let (mut answer, mut buffer) = (Vec::new(), [0; 4096]);
    loop {
        match stream.read(&mut buffer) {
            Ok(0) => return answer,
            Ok(n) => answer.extend(&buffer[..n]),
            Err(e) if e.kind() == std::io::ErrorKind::ConnectionReset => return answer,
            Err(e) => panic!("the connection does not end: {e}"),
        }
    }
}

/// The server, which runs until the end.
fn server() -> &'static SocketAddr {
    static SERVER: OnceLock<SocketAddr> = OnceLock::new();
    SERVER.get_or_init(|| {
        let (started, address) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
            runtime.block_on(async {
                let listener = http::bind(([127, 0, 0, 1], 0).into()).expect("a port");
                started.send(listener.local_addr().expect("an address")).expect("the test waits");
                let (_frames, monitored) = mpsc::channel(1);
                http::serve(listener, monitored, View::new(sources()), Hosts::new(&[])).await;
            });
        });
        address.recv().expect("the server starts")
    })
}

fn sources() -> Sources {
    let facts = StreamFacts::example(StreamId { session: 1, config: 0 });
    let condition = Condition {
        counters: Arc::default(),
        heartbeats: Arc::default(),
        receivers: watch::channel(Vec::new().into()).1,
        lock: watch::channel(None).1,
        source_down: watch::channel(None).1,
        doubts: doubts::pair().1,
    };
    Sources {
        condition,
        descriptor: watch::channel(facts.descriptor()).1,
        config: watch::channel(Config::default()).1,
        recording: Arc::new(State::new(RecordingMode::Off)),
        commands: Arc::default(),
        control: None,
    }
}
