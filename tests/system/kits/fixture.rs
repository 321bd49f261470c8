//! A daemon on its twin whose light is blocked for a while, and what it sends.

use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpStream, UdpSocket};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

use tempfile::TempDir;

/// Long enough for any machine; nothing here waits so long unless it hangs.
pub(crate) const PATIENCE: Duration = Duration::from_mins(1);

/// Ended with the test.
pub(crate) struct Running(pub(crate) Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A running daemon.
pub(crate) struct Daemon {
    process: Running,
    _config: TempDir,
}

impl Daemon {
    /// 200 frames a second, slow enough for every reader; from second 1 on every other second without light.
    pub(crate) fn start(udp: &[u16]) -> Self {
        let place = tempfile::tempdir().unwrap();
        let config = place.path().join("trifacet.toml");
        let mut text = "monitor.listen = 'off'\n[acquisition]\nrate_hz = 200.0\n".to_owned();
        for at in (1..120).step_by(2) {
            writeln!(text, "[[twin.fault]]\nkind = 'beam-blocked'\nat_s = {at}\nfor_s = 1").unwrap();
        }
        text += "[publishing]\ntcp = '127.0.0.1:0'\nudp = [";
        for port in udp {
            write!(text, "'127.0.0.1:{port}', ").unwrap();
        }
        std::fs::write(&config, text + "]\n").unwrap();
        let process = Command::new(env!("CARGO_BIN_EXE_trifacet"))
            .args(["run", "--config"])
            .arg(config)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self { process: Running(process), _config: place }
    }

    /// The port of its TCP server, which it tells in its log.
    pub(crate) fn tcp_port(&mut self) -> u16 {
        let mut log = BufReader::new(self.process.0.stderr.take().unwrap());
        let mut line = String::new();
        while log.read_line(&mut line).unwrap() > 0 {
            if let Some((_, place)) = line.split_once("listening address=127.0.0.1:") {
                let port = place.trim().parse().unwrap();
                // Goes on reading, so that the daemon can go on writing.
                std::thread::spawn(move || std::io::copy(&mut log, &mut std::io::sink()));
                return port;
            }
            line.clear();
        }
        panic!("the daemon ended before it listened");
    }
}

/// A socket for datagrams, and its port.
pub(crate) fn udp_socket() -> (UdpSocket, u16) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let port = socket.local_addr().unwrap().port();
    (socket, port)
}

/// So many datagrams.
pub(crate) fn receive(socket: &UdpSocket, count: usize) -> Vec<Vec<u8>> {
    let mut bytes = [0; 2048];
    (0..count)
        .map(|_| {
            let n = socket.recv(&mut bytes).expect("a datagram in time");
            bytes[..n].to_vec()
        })
        .collect()
}

/// What a daemon sent in its first three seconds, over UDP: with light, without, and with light again.
pub(crate) fn datagrams() -> &'static [Vec<u8>] {
    static SENT: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    SENT.get_or_init(|| {
        let (socket, port) = udp_socket();
        let _daemon = Daemon::start(&[port]);
        receive(&socket, 600)
    })
}

/// So many frames of a daemon over TCP, as they stand between the other messages.
pub(crate) fn frames_over_tcp(port: u16, count: usize) -> Vec<Vec<u8>> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
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
