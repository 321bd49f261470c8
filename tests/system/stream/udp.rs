//! Datagrams of a daemon: targets with options, multicast, leased subscriptions.

use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

use tokio::time::timeout;
use trifacet::client::{Backoff, Client, ClientError, Endpoint, Losses, Message, Options, Pace, PoseFrame};
use trifacet::exit;
use trifacet_wire::Status;

use super::fixture::publishing;
use crate::testkit::PATIENCE;

fn receiver() -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    socket
}

fn receive(socket: &UdpSocket) -> Vec<u8> {
    let mut bytes = [0; 1000];
    let n = socket.recv(&mut bytes).unwrap();
    bytes[..n].to_vec()
}

/// The answer to a datagram; frames before it are skipped.
fn ask(socket: &UdpSocket, daemon: SocketAddr, text: &str) -> String {
    socket.send_to(text.as_bytes(), daemon).unwrap();
    loop {
        let bytes = receive(socket);
        if !bytes.starts_with(b"TFP1") {
            return String::from_utf8(bytes).unwrap();
        }
    }
}

async fn next_frame(client: &mut Client) -> PoseFrame {
    match timeout(PATIENCE, client.next()).await.expect("a frame in time").unwrap() {
        Message::Pose(frame) => frame,
        other => panic!("{other:?}"),
    }
}

#[test]
fn targets_have_their_own_divider_byte_order_and_held_poses() {
    let [plain, big, held] = [receiver(), receiver(), receiver()];
    let [a, b, c] = [&plain, &big, &held].map(|socket| socket.local_addr().unwrap());
    let dark = "[[twin.fault]]\nat_s = 0.5\nkind = 'beam-blocked'";
    let _daemon = publishing(&format!(
        "tcp = 'off'\nudp = ['{a}', {{ address = '{b}', big_endian = true, divider = 7 }}, {{ address = '{c}', held = true }}]\n{dark}"
    ));
    for _ in 0..10 {
        let frame = PoseFrame::decode(&receive(&plain)).unwrap();
        assert_eq!(frame.pose[0].is_nan(), !frame.status.has(Status::POSE_VALID));
        let bytes = receive(&big);
        assert!(PoseFrame::decode(&bytes).is_err());
        let frame = PoseFrame::decode_either(&bytes).unwrap();
        assert_eq!(frame.sequence % 7, 0);
        assert_eq!(u64::from_be_bytes(bytes[16..24].try_into().unwrap()), frame.sequence);
    }
    let mut last = None;
    loop {
        let frame = PoseFrame::decode(&receive(&held)).unwrap();
        if frame.status.has(Status::POSE_VALID) {
            last = Some(frame.pose);
        } else if let Some(last) = last {
            assert!(frame.status.has(Status::POSE_HELD), "{frame:?}");
            assert_eq!(frame.pose, last);
            assert!(frame.deviations.iter().all(|d| *d == f32::INFINITY));
            return;
        }
    }
}

#[tokio::test]
async fn multicast_is_sent_through_the_interface_that_is_named() {
    // A free port, and a group that is unlikely to be in use.
    let port = receiver().local_addr().unwrap().port();
    let group = format!("239.255.{}.{}:{port}", std::process::id() % 250, port % 250);
    for interface in ["lo", "127.0.0.1"] {
        let target = format!(
            "tcp = 'off'\nudp = [{{ address = '{group}', interface = '{interface}', ttl = 1, divider = 5 }}]"
        );
        let _daemon = publishing(&target);
        let options = Options { interface: Some(interface.into()), ..Options::default() };
        let mut client = Client::connect_with(&Endpoint::Udp(group.clone()), options).await.unwrap();
        let first = timeout(PATIENCE, client.next()).await;
        let first =
            first.expect("a datagram: does this machine let multicast through its loopback interface?");
        assert!(matches!(first, Ok(Message::Pose(frame)) if frame.sequence % 5 == 0), "{first:?}");
    }
}

#[tokio::test]
async fn a_subscription_is_kept_alive_and_ended_by_the_client() {
    let mut daemon = publishing("tcp = 'off'\nudp = []\nsubscribe = '127.0.0.1:0'");
    let endpoint = Endpoint::Subscribe(daemon.subscriptions().to_string());
    let options = Options { pace: Pace::Divider(2), lease_s: 1, held: true, ..Options::default() };
    let mut client = Client::connect_with(&endpoint, options).await.unwrap();
    let first = next_frame(&mut client).await.sequence;
    // Twice the lease, at 500 frames a second.
    let mut last = first;
    while last < first + 2000 {
        last = next_frame(&mut client).await.sequence;
        assert_eq!(last % 2, 0);
    }
    assert_eq!(client.losses(), Losses::default());
}

#[test]
fn frames_end_with_the_lease_and_a_forged_request_is_not_served() {
    let mut daemon = publishing("tcp = 'off'\nudp = []\nsubscribe = '127.0.0.1:0'\nsubscribers = 1");
    let address = daemon.subscriptions();
    let [client, victim] = [receiver(), receiver()];
    let refused = ask(&client, address, "subscribe lease_s=100");
    assert_eq!(refused, "error: lease_s=100; allowed: 1 to 60");
    let challenge = ask(&client, address, "subscribe lease_s=1 divider=1");
    let nonce = challenge.strip_prefix("challenge ").unwrap();
    // The nonce of one address is invalid at another one, as is a guessed nonce.
    for forged in [nonce, "nonce=0", "nonce=ffffffffffffffff"] {
        let answer = ask(&victim, address, &format!("subscribe lease_s=60 {forged}"));
        assert!(answer.starts_with("challenge nonce=") && !answer.contains(nonce), "{answer}");
    }
    victim.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
    assert!(victim.recv(&mut [0; 300]).is_err(), "frames at an address without a subscription");
    let granted = ask(&client, address, &format!("subscribe lease_s=1 divider=1 {nonce}\n"));
    assert!(granted.starts_with("ok lease_s=1 divider=1 session="), "{granted}");
    // There is one place: the next subscriber receives the reason for the refusal.
    victim.set_read_timeout(Some(PATIENCE)).unwrap();
    let own = ask(&victim, address, "subscribe lease_s=10 divider=1");
    let own = own.strip_prefix("challenge ").unwrap();
    let full = ask(&victim, address, &format!("subscribe lease_s=10 divider=1 {own}"));
    assert!(full.starts_with("error: ") && full.contains("1 subscribers"), "{full}");
    // Frames arrive until the lease ends.
    client.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let mut frames: Vec<PoseFrame> = Vec::new();
    let mut bytes = [0; 300];
    while let Ok(n) = client.recv(&mut bytes) {
        frames.push(PoseFrame::decode(&bytes[..n]).unwrap());
        assert!(frames.len() < 20_000, "the lease never ends");
    }
    assert!(frames.len() > 100, "{}", frames.len());
    // The place is free again.
    let again = ask(&victim, address, &format!("subscribe lease_s=10 divider=1 {own}"));
    assert!(again.starts_with("ok "), "{again}");
    assert_eq!(PoseFrame::decode(&receive(&victim)).unwrap().session, frames[0].session);
    assert_eq!(ask(&victim, address, &format!("unsubscribe {own}")), "ok unsubscribed");
}

#[tokio::test]
async fn a_network_that_is_not_allowed_cannot_subscribe() {
    let mut daemon = publishing("tcp = 'off'\nudp = []\nsubscribe = '127.0.0.1:0'\nallow = ['10.0.0.0/8']");
    let endpoint = Endpoint::Subscribe(daemon.subscriptions().to_string());
    match Client::connect(&endpoint).await {
        Err(ClientError::Refused(why)) => assert!(why.contains("[publishing] allow"), "{why}"),
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn a_client_reconnects_after_a_restart_of_the_daemon() {
    // Both daemons need the same port, which is free now.
    let tcp = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let subscribe = receiver().local_addr().unwrap();
    let keys = format!("tcp = '{tcp}'\nudp = []\nsubscribe = '{subscribe}'");
    let mut daemon = publishing(&keys);
    assert_eq!(daemon.address(), tcp);
    assert_eq!(daemon.subscriptions(), subscribe);
    let backoff = Backoff { first: Duration::from_millis(20), most: Duration::from_millis(200) };
    for endpoint in [Endpoint::Tcp(tcp.to_string()), Endpoint::Subscribe(subscribe.to_string())] {
        let options = Options { reconnect: Some(backoff), ..Options::default() };
        let mut client = Client::connect_with(&endpoint, options).await.unwrap();
        let session = session(&mut client).await;
        drop(daemon);
        daemon = publishing(&keys);
        let came_back = async { while self::session(&mut client).await == session {} };
        timeout(PATIENCE, came_back).await.expect("it connects again");
        assert!(client.reconnects() > 0 || matches!(endpoint, Endpoint::Subscribe(_)));
        assert_eq!(client.losses().missed_frames, 0, "a restart is no gap");
    }
}

/// The session of the next frame.
async fn session(client: &mut Client) -> u32 {
    loop {
        if let Message::Pose(frame) = timeout(PATIENCE, client.next()).await.unwrap().unwrap() {
            return frame.session;
        }
    }
}

/// The sockets of subscribers share the port of the daemon; no other program may.
#[tokio::test]
async fn a_port_with_subscribers_is_not_shared_with_a_second_daemon() {
    let mut daemon = publishing("tcp = 'off'\nudp = []\nsubscribe = '127.0.0.1:0'");
    let address = daemon.subscriptions();
    let endpoint = Endpoint::Subscribe(address.to_string());
    let mut client = Client::connect(&endpoint).await.unwrap();
    let first = next_frame(&mut client).await.sequence;
    let mut second = publishing(&format!("tcp = 'off'\nudp = []\nsubscribe = '{address}'"));
    assert_eq!(second.end().code(), Some(i32::from(exit::IN_USE)), "{:#?}", second.log);
    assert!(second.said("another process has the port"), "{:#?}", second.log);
    while next_frame(&mut client).await.sequence < first + 1000 {}
    assert_eq!(client.losses(), Losses::default());
}

/// A server on all addresses sends IPv4 and IPv6 datagrams from its own port.
#[tokio::test]
async fn a_server_for_both_versions_of_ip_serves_both() {
    let mut daemon = publishing("tcp = 'off'\nudp = []\nsubscribe = '[::]:0'");
    let port = daemon.subscriptions().port();
    for own in ["127.0.0.1", "[::1]"] {
        let endpoint = Endpoint::Subscribe(format!("{own}:{port}"));
        let options = Options { lease_s: 1, ..Options::default() };
        let mut client = timeout(PATIENCE, Client::connect_with(&endpoint, options)).await.unwrap().unwrap();
        let first = next_frame(&mut client).await.sequence;
        // Three leases: the renewals arrive at the socket of this subscriber.
        while next_frame(&mut client).await.sequence < first + 3000 {}
        assert_eq!(client.losses(), Losses::default(), "{own}");
    }
}
