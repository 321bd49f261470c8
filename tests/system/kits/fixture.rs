//! A daemon on its twin with a beam that is blocked at times, and the frames that it sends.

use std::fmt::Write as _;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::OnceLock;

use crate::testkit::{Daemon, PATIENCE, Udp};

/// A daemon that sends 200 frames a second, slow enough for every reader, to these ports. From second 1 on,
/// the beam is blocked in every other second.
pub(crate) fn daemon(udp: &[u16]) -> Daemon {
    let ports: Vec<_> = udp.iter().map(|port| format!("'127.0.0.1:{port}'")).collect();
    let mut text = format!(
        "acquisition.rate_hz = 200.0
publishing.udp = [{}]
",
        ports.join(", ")
    );
    for at in (1..120).step_by(2) {
        writeln!(
            text,
            "[[twin.fault]]
kind = 'beam-blocked'
at_s = {at}
for_s = 1"
        )
        .unwrap();
    }
    Daemon::start(&text)
}

/// Receives `count` datagrams.
pub(crate) fn receive(udp: &Udp, count: usize) -> Vec<Vec<u8>> {
    (0..count).map(|_| udp.datagram()).collect()
}

/// The datagrams of the first three seconds of a daemon: with light, without light, and with light again.
pub(crate) fn datagrams() -> &'static [Vec<u8>] {
    static SENT: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    SENT.get_or_init(|| {
        let udp = Udp::open();
        let _daemon = daemon(&[udp.address().port()]);
        receive(&udp, 600)
    })
}

/// The next `count` frames of a daemon over TCP, without the other messages.
pub(crate) fn frames_over_tcp(address: SocketAddr, count: usize) -> Vec<Vec<u8>> {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(b"stream format=binary divider=2\n").unwrap();
    let mut frames = Vec::new();
    while frames.len() < count {
        let mut message = vec![0; 8];
        stream.read_exact(&mut message).unwrap();
        let size = u16::from_le_bytes([message[6], message[7]]);
        message.resize(size.into(), 0);
        stream.read_exact(&mut message[8..]).unwrap();
        if message.starts_with(b"TFP1") {
            frames.push(message);
        }
    }
    frames
}
