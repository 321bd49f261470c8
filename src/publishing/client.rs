//! A client of the stream, for Rust programs (`trifacet::client`) and for `trifacet watch`.
//!
//! ```no_run
//! # async fn example() -> Result<(), trifacet::client::ClientError> {
//! use trifacet::client::{Client, Message};
//!
//! let mut client = Client::connect(&"tcp://127.0.0.1:7361".parse()?).await?;
//! loop {
//!     if let Message::Pose(frame) = client.next().await? {
//!         println!("{} {:?}", frame.sequence, frame.pose);
//!     }
//! }
//! # }
//! ```

use std::{fmt, io, net::SocketAddr, str::FromStr};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpStream, UdpSocket, lookup_host},
};

pub use super::{
    descriptor::{Descriptor, Heartbeat, Refusal},
    frame::{FrameError, PoseFrame},
    message::{Message, MessageError},
};
use super::{layout::FRAME_SIZE, message::Decoder, request::Request};

/// The default of Linux holds 256 frames, which 10 kHz fill in 26 ms.
const RECEIVE_BUFFER: usize = 1024 * 1024;

/// Where a stream comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// A daemon's TCP server, as "host:port".
    Tcp(String),
    /// The local address, as "host:port", to which a daemon sends datagrams.
    Udp(String),
}

impl FromStr for Endpoint {
    type Err = ClientError;

    fn from_str(text: &str) -> Result<Self, ClientError> {
        let bad = || ClientError::Endpoint(text.to_owned());
        let (scheme, place) = text.split_once("://").ok_or_else(bad)?;
        let (host, port) = place.rsplit_once(':').ok_or_else(bad)?;
        if host.is_empty() || port.parse::<u16>().is_err() {
            return Err(bad());
        }
        match scheme {
            "tcp" => Ok(Self::Tcp(place.to_owned())),
            "udp" => Ok(Self::Udp(place.to_owned())),
            _ => Err(bad()),
        }
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(place) => write!(f, "tcp://{place}"),
            Self::Udp(place) => write!(f, "udp://{place}"),
        }
    }
}

/// Why there is no stream, or no more of it.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The address cannot be read.
    #[error("\"{0}\" is no address of a stream: it must be tcp://HOST:PORT or udp://HOST:PORT")]
    Endpoint(String),
    /// The address cannot be reached, or not be opened.
    #[error("cannot open {endpoint}: {source}")]
    Open {
        /// Which one.
        endpoint: Endpoint,
        /// What the system says.
        source: io::Error,
    },
    /// The daemon does not serve this client.
    #[error("{0}")]
    Refused(String),
    /// The stream has ended in order.
    #[error("the daemon closed the stream")]
    Closed,
    /// The stream broke.
    #[error("the stream broke: {0}")]
    Broken(#[from] io::Error),
    /// The other side says what this program cannot read.
    #[error(transparent)]
    Message(#[from] MessageError),
}

/// What went missing on the way, counted by the client itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Frames missing in the sequence.
    pub missed_frames: u64,
    /// Frames that came after a younger one, or twice (UDP only); they count as missed before that.
    pub late_frames: u64,
    /// Bytes that belonged to no undamaged message.
    pub skipped_bytes: u64,
}

/// A stream of messages from a daemon.
#[derive(Debug)]
pub struct Client {
    link: Link,
    order: Order,
}

#[derive(Debug)]
enum Link {
    Tcp { stream: TcpStream, decoder: Decoder },
    Udp { socket: UdpSocket, skipped: u64 },
}

impl Client {
    /// Connects to a daemon, or opens the port to which one sends. With UDP this says nothing about
    /// whether anyone does.
    pub async fn connect(endpoint: &Endpoint) -> Result<Self, ClientError> {
        let open = async {
            Ok(match endpoint {
                Endpoint::Tcp(place) => {
                    let mut stream = TcpStream::connect(place).await?;
                    stream.set_nodelay(true)?;
                    stream.write_all(format!("{}\n", Request::default()).as_bytes()).await?;
                    Link::Tcp { stream, decoder: Decoder::default() }
                }
                Endpoint::Udp(place) => Link::Udp { socket: open_udp(place).await?, skipped: 0 },
            })
        };
        let link = open.await.map_err(|source| ClientError::Open { endpoint: endpoint.clone(), source })?;
        Ok(Self { link, order: Order::default() })
    }

    /// The next message. Over TCP the first one is the descriptor; over UDP there are frames only.
    /// Damaged bytes are stepped over and counted. Cancel-safe: dropping the future loses nothing.
    ///
    /// Every error is final, and [`ClientError::Refused`] is what the daemon says to a client that it
    /// does not serve.
    pub async fn next(&mut self) -> Result<Message, ClientError> {
        let message = match &mut self.link {
            Link::Tcp { stream, decoder } => next_tcp(stream, decoder).await?,
            Link::Udp { socket, skipped } => next_udp(socket, skipped).await?,
        };
        match message {
            Message::Pose(frame) => self.order.note(&frame),
            Message::Refusal(Refusal { error }) => return Err(ClientError::Refused(error)),
            Message::Descriptor(_) | Message::Heartbeat(_) | Message::Answer(_) => {}
        }
        Ok(message)
    }

    /// What went missing so far.
    pub fn losses(&self) -> Losses {
        let skipped_bytes = match &self.link {
            Link::Tcp { decoder, .. } => decoder.skipped(),
            Link::Udp { skipped, .. } => *skipped,
        };
        Losses { skipped_bytes, ..self.order.losses }
    }

    /// The address of this side; with UDP, where a daemon must send.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        match &self.link {
            Link::Tcp { stream, .. } => stream.local_addr(),
            Link::Udp { socket, .. } => socket.local_addr(),
        }
    }
}

async fn open_udp(place: &str) -> io::Result<UdpSocket> {
    let addresses: Vec<SocketAddr> = lookup_host(place).await?.collect();
    let socket = UdpSocket::bind(&addresses[..]).await?;
    // The kernel grants no more than net.core.rmem_max, and says nothing about it.
    rustix::net::sockopt::set_socket_recv_buffer_size(&socket, RECEIVE_BUFFER)?;
    Ok(socket)
}

async fn next_tcp(stream: &mut TcpStream, decoder: &mut Decoder) -> Result<Message, ClientError> {
    loop {
        if let Some(message) = decoder.next_message() {
            return Ok(message?);
        }
        if stream.read_buf(decoder.room()).await? == 0 {
            return Err(ClientError::Closed);
        }
    }
}

async fn next_udp(socket: &UdpSocket, skipped: &mut u64) -> Result<Message, ClientError> {
    // One byte more than a frame: a longer datagram must not look like one.
    let mut bytes = [0; FRAME_SIZE + 1];
    loop {
        let n = socket.recv(&mut bytes).await?;
        match PoseFrame::decode(&bytes[..n]) {
            Ok(frame) => return Ok(Message::Pose(frame)),
            Err(FrameError::Version { major, minor }) => {
                return Err(MessageError::Version { major, minor }.into());
            }
            Err(_) => *skipped += n as u64,
        }
    }
}

/// Watches the sequence numbers.
#[derive(Debug, Default)]
struct Order {
    /// Session and sequence of the youngest frame.
    last: Option<(u32, u64)>,
    losses: Losses,
}

impl Order {
    fn note(&mut self, frame: &PoseFrame) {
        match self.last {
            Some((session, last)) if session == frame.session => {
                if frame.sequence <= last {
                    self.losses.late_frames += 1;
                    return;
                }
                self.losses.missed_frames += frame.sequence - last - 1;
            }
            // The first frame, or the first of a daemon that was restarted.
            _ => {}
        }
        self.last = Some((frame.session, frame.sequence));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        clock::Mono,
        publishing::stamp::{Stamp, tests::report},
    };

    fn frame(session: u32, sequence: u64) -> PoseFrame {
        let stamp = Stamp { session, config: 0, sequence, time_ns: 0, synced: true, sent: Mono(0) };
        PoseFrame::from_report(&report(), stamp)
    }

    #[test]
    fn endpoints_are_checked() {
        assert_eq!("tcp://[::1]:7361".parse::<Endpoint>().unwrap(), Endpoint::Tcp("[::1]:7361".into()));
        assert_eq!("udp://lab:7362".parse::<Endpoint>().unwrap().to_string(), "udp://lab:7362");
        for bad in ["127.0.0.1:7361", "http://a:1", "tcp://a", "tcp://:1", "udp://a:70000", ""] {
            let error = bad.parse::<Endpoint>().unwrap_err().to_string();
            assert!(error.contains("tcp://HOST:PORT"), "{error}");
        }
    }

    #[test]
    fn gaps_are_counted_and_a_restart_is_none() {
        let mut order = Order::default();
        for (session, sequence) in [(1, 100), (1, 101), (1, 105), (1, 103), (1, 106), (2, 0), (2, 2)] {
            order.note(&frame(session, sequence));
        }
        assert_eq!(order.losses, Losses { missed_frames: 4, late_frames: 1, skipped_bytes: 0 });
    }

    #[tokio::test]
    async fn datagrams_are_read_and_others_counted() {
        let mut client = Client::connect(&"udp://127.0.0.1:0".parse().unwrap()).await.unwrap();
        let to = client.local_addr().unwrap();
        let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        let mut too_long = frame(1, 1).encode().to_vec();
        too_long.push(0);
        let good = frame(1, 2).encode();
        for bytes in [b"hello".as_slice(), &too_long, &good] {
            socket.send_to(bytes, to).unwrap();
        }
        assert_eq!(client.next().await.unwrap(), Message::Pose(frame(1, 2)));
        assert_eq!(client.losses().skipped_bytes, 5 + 193);
        let mut other = good;
        other[4] = 2;
        socket.send_to(&other, to).unwrap();
        let error = client.next().await.unwrap_err();
        assert!(error.to_string().contains("version 2.0"), "{error}");
    }
}
