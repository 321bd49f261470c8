//! The TCP server and its client over real loopback sockets.

use std::net::SocketAddr;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::time::timeout;
use trifacet::client::{Client, ClientError, Endpoint, Heartbeat, Losses, Message};
use trifacet::exit;
use trifacet::publishing::tcp::{self, Limits};
use trifacet_wire::stream::Decoder;

use super::fixture::{Server, descriptor, frame, start};
use crate::testkit::PATIENCE;

/// A client that has received the descriptor and the first heartbeat, and so receives every frame from now
/// on.
async fn connect(address: SocketAddr) -> Client {
    let mut client = Client::connect(&Endpoint::Tcp(address.to_string())).await.unwrap();
    match next(&mut client).await {
        Message::Descriptor(mut d) => {
            assert_eq!(d.stream.take().map(|s| (s.format, s.divider)), Some(("binary".into(), 1)));
            assert_eq!(*d, descriptor());
        }
        other => panic!("{other:?} before the descriptor"),
    }
    assert!(matches!(next(&mut client).await, Message::Heartbeat(_)));
    client
}

async fn next(client: &mut Client) -> Message {
    timeout(PATIENCE, client.next()).await.expect("a message in time").unwrap()
}

async fn next_sequence(client: &mut Client) -> u64 {
    loop {
        if let Message::Pose(frame) = next(client).await {
            return frame.sequence;
        }
    }
}

/// Sends frames in batches; all reading clients receive one batch before the next.
async fn send_to_readers(server: &Server, count: u64, readers: &mut [Client]) {
    for first in (0..count).step_by(64) {
        for sequence in first..(first + 64).min(count) {
            server.frames.send(frame(sequence)).await.unwrap();
        }
        for reader in &mut *readers {
            for sequence in first..(first + 64).min(count) {
                assert_eq!(next_sequence(reader).await, sequence);
            }
        }
    }
}

/// A connection with a small receive buffer, read only on demand.
async fn stalled(address: SocketAddr) -> TcpStream {
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(16 * 1024).unwrap();
    let mut stream = socket.connect(address).await.unwrap();
    stream.write_all(b"stream\n").await.unwrap();
    // After the first byte of the descriptor, the client is being served.
    assert_eq!(stream.read_u8().await.unwrap(), b'T');
    stream
}

/// Continues to read after a stall until a heartbeat accounts for `total` frames; returns the received
/// frames.
async fn read_on(mut stream: TcpStream, total: u64) -> (u64, Heartbeat) {
    let mut decoder = Decoder::default();
    decoder.push(b"T");
    let mut frames = 0;
    loop {
        match decoder.next_message() {
            Some(Ok(Message::Pose(_))) => frames += 1,
            Some(Ok(Message::Heartbeat(h))) if h.sent + h.dropped == total => return (frames, h),
            Some(other) => drop(other.unwrap()),
            None => {
                let read = timeout(PATIENCE, stream.read_buf(decoder.room())).await;
                assert_ne!(read.expect("bytes in time").unwrap(), 0, "the stream continues");
            }
        }
    }
}

#[tokio::test]
async fn a_client_that_never_reads_costs_the_others_no_frame() {
    const FRAMES: u64 = 20_000;
    let server = start(Limits { clients: 8, queue: 256, ..Limits::default() }).await;
    let mut readers = [connect(server.address).await, connect(server.address).await];
    let stalled = stalled(server.address).await;
    send_to_readers(&server, FRAMES, &mut readers).await;
    assert!(readers.iter().all(|r| r.losses() == Losses::default()), "{readers:?}");

    let (received, heartbeat) = read_on(stalled, FRAMES).await;
    assert!(heartbeat.dropped > 0, "{FRAMES} frames do not fit any buffer");
    assert_eq!(heartbeat.sent, received);
    assert_eq!(heartbeat.counters["tcp_dropped"], heartbeat.dropped);
    assert_eq!(server.counters.tcp_dropped.get(), heartbeat.dropped);
}

#[tokio::test]
async fn a_client_that_sends_garbage_is_answered_then_disconnected_and_costs_the_others_no_frame() {
    let server = start(Limits { clients: 8, queue: 256, ..Limits::default() }).await;
    let mut readers = [connect(server.address).await];
    let mut rude = TcpStream::connect(server.address).await.unwrap();
    rude.write_all(&b"\0GET / HTTP/1.1\r\n\xff\n".repeat(5000)).await.unwrap();
    let mut all = Vec::new();
    timeout(PATIENCE, rude.read_to_end(&mut all)).await.unwrap().unwrap();
    let text = String::from_utf8(all).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 100);
    assert!(lines.iter().all(|line| line.starts_with("error: ") && line.is_ascii()), "{text}");
    assert!(lines[99].contains("100 lines without a valid command"), "{}", lines[99]);

    let mut endless = TcpStream::connect(server.address).await.unwrap();
    endless.write_all(&vec![b'x'; 100_000]).await.unwrap();
    let mut all = String::new();
    timeout(PATIENCE, endless.read_to_string(&mut all)).await.unwrap().unwrap();
    assert_eq!(all, "error: a line of more than 256 bytes\n");
    send_to_readers(&server, 1000, &mut readers).await;
    assert_eq!(readers[0].losses().missed_frames, 0);
}

#[tokio::test]
async fn the_last_frames_and_a_heartbeat_arrive_before_the_end() {
    let server = start(Limits { clients: 8, queue: 256, ..Limits::default() }).await;
    let mut client = connect(server.address).await;
    for sequence in 0..100 {
        server.frames.send(frame(sequence)).await.unwrap();
    }
    server.shutdown.cancel();
    drop(server.frames);
    let (mut frames, mut last) = (0, Heartbeat::default());
    loop {
        match timeout(PATIENCE, client.next()).await.unwrap() {
            Ok(Message::Pose(_)) => frames += 1,
            Ok(Message::Heartbeat(heartbeat)) => last = heartbeat,
            Err(ClientError::Closed) => break,
            other => panic!("{other:?}"),
        }
    }
    assert_eq!((frames, last.sent, last.dropped), (100, 100, 0));
    server.task.await.unwrap();
}

#[tokio::test]
async fn a_client_beyond_the_limit_is_refused_with_the_reason_and_free_places_are_reused() {
    let server = start(Limits { clients: 1, queue: 256, ..Limits::default() }).await;
    let first = connect(server.address).await;
    let endpoint = Endpoint::Tcp(server.address.to_string());
    let mut second = Client::connect(&endpoint).await.unwrap();
    match timeout(PATIENCE, second.next()).await.unwrap() {
        Err(ClientError::Refused(why)) => assert!(why.contains("1 TCP clients"), "{why}"),
        other => panic!("{other:?}"),
    }
    drop(first);
    // The server detects the closed connection at its next write: send frames until then.
    let admitted = async {
        loop {
            let _ = server.frames.send(frame(0)).await;
            let mut third = Client::connect(&endpoint).await.unwrap();
            if let Ok(Message::Descriptor(_)) = third.next().await {
                return;
            }
        }
    };
    timeout(PATIENCE, admitted).await.expect("the place becomes free");
}

#[tokio::test]
async fn a_client_that_reads_nothing_for_long_loses_its_place() {
    let stall = Duration::from_secs(1);
    let server = start(Limits { clients: 1, queue: 64, stall, ..Limits::default() }).await;
    let hung = stalled(server.address).await;
    let endpoint = Endpoint::Tcp(server.address.to_string());
    let mut refused = 0;
    let admitted = async {
        loop {
            // Enough to fill the buffers of the sockets.
            for sequence in 0..1000 {
                server.frames.send(frame(sequence)).await.unwrap();
            }
            let mut other = Client::connect(&endpoint).await.unwrap();
            match other.next().await {
                Ok(Message::Descriptor(_)) => return,
                Err(ClientError::Refused(_)) => refused += 1,
                other => panic!("{other:?}"),
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    timeout(PATIENCE, admitted).await.expect("the stalled client is disconnected");
    assert!(refused > 0, "a client may pause for a while");
    drop(hung);
}

#[tokio::test]
async fn a_client_resynchronises_in_a_damaged_stream() {
    let server = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = Endpoint::Tcp(server.local_addr().unwrap().to_string());
    let mut damaged = frame(1).encode();
    damaged[90] ^= 1;
    let stream =
        [&frame(0).encode()[..], &damaged, b"TFP1?", &frame(2).encode()[7..], &frame(3).encode()].concat();
    let sending = tokio::spawn(async move {
        let (mut socket, _) = server.accept().await.unwrap();
        socket.read_u8().await.unwrap(); // a close with the request unread would reset the socket
        assert!(socket.read(&mut [0; 256]).await.unwrap() > 0);
        socket.write_all(&stream).await.unwrap();
    });
    let mut client = Client::connect(&endpoint).await.unwrap();
    assert_eq!(next_sequence(&mut client).await, 0);
    assert_eq!(next_sequence(&mut client).await, 3);
    assert_eq!(client.losses().missed_frames, 2);
    assert_eq!(client.losses().skipped_bytes, 192 + 5 + 185);
    sending.await.unwrap();
    assert!(matches!(client.next().await, Err(ClientError::Closed)));
}

#[tokio::test]
async fn a_port_in_use_is_named() {
    let first = tcp::bind(([127, 0, 0, 1], 0).into()).unwrap();
    let address = first.local_addr().unwrap();
    let failure = tcp::bind(address).unwrap_err();
    assert_eq!(failure.code, exit::IN_USE);
    assert!(failure.message.contains(&address.to_string()), "{failure}");
}
