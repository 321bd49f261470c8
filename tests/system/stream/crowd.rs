//! Many clients of a daemon at once: no client costs another one a frame or the daemon a sample.

use std::net::SocketAddr;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};
use trifacet::client::{Client, ClientError, Endpoint, Heartbeat, Losses, Message};

use super::fixture::publishing;
use crate::testkit::{Daemon, Folder, PATIENCE};

async fn connect(address: SocketAddr) -> Client {
    let mut client = Client::connect(&Endpoint::Tcp(address.to_string())).await.unwrap();
    assert!(matches!(client.next().await.unwrap(), Message::Descriptor(_)));
    client
}

/// Reads more than `enough` frames, up to a heartbeat; returns their number, the losses, and the heartbeat.
async fn read(mut client: Client, enough: u64) -> (u64, Losses, Heartbeat) {
    let mut frames = 0;
    loop {
        match timeout(PATIENCE, client.next()).await.unwrap().unwrap() {
            Message::Pose(_) => frames += 1,
            Message::Heartbeat(heartbeat) => {
                if frames > enough {
                    return (frames, client.losses(), heartbeat);
                }
            }
            other => panic!("{other:?}"),
        }
    }
}

fn nothing_lost((frames, losses, heartbeat): &(u64, Losses, Heartbeat)) {
    assert!(*frames > 1000, "{frames}");
    assert_eq!((*losses, heartbeat.dropped), (Losses::default(), 0), "{heartbeat:?}");
    for counter in ["scans_lost", "estimation_overflows", "tcp_overflows"] {
        assert_eq!(heartbeat.counters[counter], 0, "{heartbeat:?}");
    }
}

#[tokio::test]
async fn of_64_clients_at_1_khz_one_stalls_and_the_others_lose_nothing() {
    let mut daemon = publishing("tcp = '127.0.0.1:0'\nudp = []\ntcp_queue = 2048");
    let address = daemon.address();
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(4096).unwrap();
    let mut stalled = socket.connect(address).await.unwrap();
    stalled.write_all(b"stream format=json\n").await.unwrap();
    stalled.read_u8().await.unwrap();
    let mut readers = JoinSet::new();
    for _ in 0..63 {
        readers.spawn(read(connect(address).await, 5000));
    }
    let mut extra = TcpStream::connect(address).await.unwrap();
    extra.write_all(b"pose?\n").await.unwrap();
    let mut refusal = String::new();
    timeout(PATIENCE, extra.read_to_string(&mut refusal)).await.unwrap().unwrap();
    assert!(refusal.starts_with("error: the daemon already serves 64 TCP clients"), "{refusal}");
    let mut refused = 0;
    while let Some(reader) = readers.join_next().await {
        let reader = reader.unwrap();
        nothing_lost(&reader);
        refused = refused.max(reader.2.counters["tcp_refused"]);
    }
    assert_eq!(refused, 1);
    // 5000 lines of JSON exceed the queue and the sockets: the client is disconnected, and its missed
    // frames are counted.
    let mut recorder = connect(address).await;
    let counted = async {
        loop {
            if let Message::Heartbeat(heartbeat) = recorder.next().await.unwrap()
                && heartbeat.counters["tcp_dropped"] > 0
            {
                return;
            }
        }
    };
    timeout(Duration::from_mins(1), counted).await.expect("the stalled client is disconnected");
    drop(stalled);
}

#[tokio::test]
async fn two_hundred_clients_that_come_and_go_cost_the_others_no_frame() {
    let mut daemon = publishing("tcp = '127.0.0.1:0'\nudp = []\ntcp_queue = 4096\ntcp_clients = 250");
    let address = daemon.address();
    let steady = tokio::spawn(read(connect(address).await, 3000));
    for n in 0..200 {
        let mut visitor = TcpStream::connect(address).await.unwrap();
        match n % 4 {
            0 => {}
            1 => visitor.write_all(b"stre").await.unwrap(),
            2 => {
                visitor.write_all(b"stream format=csv\n").await.unwrap();
                visitor.read_u8().await.unwrap();
            }
            _ => {
                visitor.write_all(b"stream\npose?\n").await.unwrap();
                visitor.set_zero_linger().unwrap(); // closes with a reset
            }
        }
        sleep(Duration::from_millis(8)).await;
    }
    nothing_lost(&steady.await.unwrap());
    // All places are free again: all of them can be taken at once.
    let mut all = Vec::new();
    for _ in 0..250 {
        all.push(connect(address).await);
    }
}

/// More clients than the daemon may open files: it accepts others as soon as some have left.
#[tokio::test]
async fn a_daemon_without_free_file_descriptors_accepts_clients_later() {
    let config = "[publishing]\ntcp = '127.0.0.1:0'\nudp = []\nsubscribe = '127.0.0.1:0'\n";
    let through = ["sh", "-c", "ulimit -n 40; exec \"$@\"", "sh"];
    let mut daemon = Daemon::start_through(&Folder::new(), config, &through);
    let (tcp, subscribe) = (daemon.address(), daemon.subscriptions());
    // The start itself needs descriptors: it is complete when there are frames.
    let mut first = connect(tcp).await;
    assert!(timeout(PATIENCE, first.next()).await.unwrap().is_ok());
    let mut clients = Vec::new();
    for _ in 0..60 {
        clients.push(TcpStream::connect(tcp).await.unwrap());
    }
    let line = daemon.message("cannot accept a TCP client");
    assert!(line["message"].as_str().unwrap().contains("Too many open files"), "{line}");
    let endpoint = Endpoint::Subscribe(subscribe.to_string());
    match Client::connect(&endpoint).await {
        Err(ClientError::Refused(why)) => assert!(why.contains("Too many open files"), "{why}"),
        other => panic!("{other:?}"),
    }
    drop((first, clients));
    let mut client = timeout(PATIENCE, connect(tcp)).await.unwrap();
    assert!(timeout(PATIENCE, client.next()).await.unwrap().is_ok());
    daemon.message("accepted a TCP client again");
    let began = daemon.log.iter().filter(|line| line.to_string().contains("cannot accept a TCP client"));
    assert_eq!(began.count(), 1, "{:#?}", daemon.log);
    timeout(PATIENCE, Client::connect(&endpoint)).await.unwrap().unwrap();
}
