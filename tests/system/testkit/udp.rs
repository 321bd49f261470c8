//! A port that receives the datagrams of a daemon.

use std::net::{SocketAddr, UdpSocket};

use trifacet::client::PoseFrame;

use super::PATIENCE;

pub(crate) struct Udp(UdpSocket);

impl Udp {
    /// A free port with a large receive buffer for tests that read late.
    pub(crate) fn open() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        rustix::net::sockopt::set_socket_recv_buffer_size(&socket, 1 << 22).unwrap();
        Self(socket)
    }

    pub(crate) fn address(&self) -> SocketAddr {
        self.0.local_addr().unwrap()
    }

    /// The next datagram.
    pub(crate) fn datagram(&self) -> Vec<u8> {
        let mut bytes = [0; 2048];
        let n = self.0.recv(&mut bytes).expect("a datagram in time");
        bytes[..n].to_vec()
    }

    /// The next frame.
    pub(crate) fn frame(&self) -> PoseFrame {
        PoseFrame::decode(&self.datagram()).unwrap()
    }

    /// Drops all datagrams that have arrived.
    pub(crate) fn drain(&self) {
        self.0.set_nonblocking(true).unwrap();
        while self.0.recv(&mut [0; 2048]).is_ok() {}
        self.0.set_nonblocking(false).unwrap();
    }
}
