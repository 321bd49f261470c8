//! A client of the stream, for Rust programs (`trifacet::client`) and for `trifacet watch`.
//!
//! ```no_run
//! # async fn example() -> Result<(), trifacet::client::ClientError> {
//! use trifacet::client::{Backoff, Client, Message, Options, Pace};
//!
//! let options = Options {
//!     pace: Pace::RateHz(100.0),
//!     reconnect: Some(Backoff::default()),
//!     ..Options::default()
//! };
//! let mut client = Client::connect_with(&"tcp://127.0.0.1:7361".parse()?, options).await?;
//! loop {
//!     if let Message::Pose(frame) = client.next().await? {
//!         println!("{} {:?}", frame.sequence, frame.pose);
//!     }
//! }
//! # }
//! ```

mod endpoint;
mod link;
mod losses;

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::time::{Instant, sleep_until, timeout, timeout_at};
pub use trifacet_wire::stream::{
    Answer, Descriptor, Heartbeat, Message, MessageError, Pace, Refusal, StreamForm,
};
pub use trifacet_wire::{FrameError, PoseFrame};

pub use self::endpoint::{ClientError, Endpoint};
use self::link::Link;
use self::losses::LossCounter;
pub use self::losses::Losses;

/// A daemon is heard each second. If it is not for so long, the link is dead: a client that connects
/// again by itself does so.
const SILENCE: Duration = Duration::from_secs(5);

/// What a client wants.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// How many of the frames (TCP, subscriptions; a subscription takes a divider only). Over UDP
    /// without a subscription the daemon's configuration decides.
    pub pace: Pace,
    /// Whether the last valid pose stays, with `POSE_HELD`, instead of NaN; likewise.
    pub held: bool,
    /// A multicast group is heard through this interface: its name, or for IPv4 its address.
    pub interface: Option<String>,
    /// A subscription lasts so long beyond its last renewal: 1 to 60 s.
    pub lease_s: u32,
    /// Whether to connect again, and again, when the stream ends or breaks.
    pub reconnect: Option<Backoff>,
}

impl Default for Options {
    fn default() -> Self {
        Self { pace: Pace::default(), held: false, interface: None, lease_s: 10, reconnect: None }
    }
}

/// How long to wait before each attempt to connect again: twice as long each time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Backoff {
    /// Before the first one.
    pub first: Duration,
    /// At most.
    pub most: Duration,
}

impl Default for Backoff {
    fn default() -> Self {
        Self { first: Duration::from_millis(100), most: Duration::from_secs(5) }
    }
}

/// A stream of messages from a daemon.
#[derive(Debug)]
pub struct Client {
    endpoint: Endpoint,
    options: Options,
    state: State,
    losses: LossCounter,
    /// Bytes skipped in links that are no more.
    skipped: u64,
    reconnects: u64,
    /// What the next attempt to connect again waits.
    wait: Duration,
}

#[derive(Debug)]
enum State {
    Up { link: Link, heard: Instant },
    Down { retry: Instant },
}

impl Client {
    /// Connects to a daemon for every frame, or opens the port to which one sends. With UDP this says
    /// nothing about whether anyone does.
    pub async fn connect(endpoint: &Endpoint) -> Result<Self, ClientError> {
        Self::connect_with(endpoint, Options::default()).await
    }

    /// As [`Client::connect`], with wishes. The first attempt is the only one, whatever the options say:
    /// an address that was never right is an error.
    pub async fn connect_with(endpoint: &Endpoint, options: Options) -> Result<Self, ClientError> {
        let link = Link::open(endpoint, &options).await?;
        let step = match (endpoint, options.pace) {
            (Endpoint::Tcp(_) | Endpoint::Subscribe(_), Pace::Divider(divider)) => Some(divider.into()),
            _ => None,
        };
        Ok(Self {
            endpoint: endpoint.clone(),
            wait: options.reconnect.unwrap_or_default().first,
            options,
            state: State::Up { link, heard: Instant::now() },
            losses: LossCounter::new(step),
            skipped: 0,
            reconnects: 0,
        })
    }

    /// The next message. Over TCP the first one is the descriptor; over UDP there are frames only.
    /// Damaged bytes are stepped over and counted. Cancel-safe: dropping the future loses nothing.
    ///
    /// Every error is final, and [`ClientError::Refused`] is what the daemon says to a client that it
    /// does not serve. With [`Options::reconnect`] there are no errors but that and a version that
    /// cannot be read: it waits until there is a message again.
    pub async fn next(&mut self) -> Result<Message, ClientError> {
        loop {
            match self.step().await {
                Ok(Some(message)) => return Ok(message),
                Ok(None) => {}
                Err(e) => self.bear(e)?,
            }
        }
    }

    /// Goes one step on: connects, or takes a message or a sign of life.
    async fn step(&mut self) -> Result<Option<Message>, ClientError> {
        match &mut self.state {
            State::Down { retry } => {
                sleep_until(*retry).await;
                let silent = |_| io::Error::new(io::ErrorKind::TimedOut, "no answer");
                let link =
                    timeout(SILENCE, Link::open(&self.endpoint, &self.options)).await.map_err(silent)??;
                self.state = State::Up { link, heard: Instant::now() };
                self.reconnects += 1;
                Ok(None)
            }
            State::Up { link, heard } => {
                let message = if self.options.reconnect.is_some() && !matches!(link, Link::Udp { .. }) {
                    let silent = |_| io::Error::new(io::ErrorKind::TimedOut, "no sign of life");
                    timeout_at(*heard + SILENCE, link.next()).await.map_err(silent)??
                } else {
                    link.next().await?
                };
                *heard = Instant::now();
                message.map(|message| self.note(message)).transpose()
            }
        }
    }

    fn note(&mut self, message: Message) -> Result<Message, ClientError> {
        match &message {
            Message::Pose(frame) => {
                self.losses.note(frame);
                self.wait = self.options.reconnect.unwrap_or_default().first;
            }
            Message::Descriptor(descriptor) => {
                self.losses.step = descriptor.stream.as_ref().map(|stream| stream.divider.into());
            }
            Message::Refusal(Refusal { error }) => return Err(ClientError::Refused(error.clone())),
            Message::Heartbeat(_) | Message::Answer(_) => {}
        }
        Ok(message)
    }

    /// Plans the next attempt after an error that another attempt may mend; gives back others.
    fn bear(&mut self, error: ClientError) -> Result<(), ClientError> {
        use ClientError::{Broken, Closed, Open};
        let Some(backoff) = self.options.reconnect else { return Err(error) };
        if !matches!(error, Broken(_) | Closed | Open { .. }) {
            return Err(error);
        }
        tracing::debug!(endpoint = %self.endpoint, "{error}");
        self.skipped = self.losses().skipped_bytes;
        self.state = State::Down { retry: Instant::now() + self.wait };
        self.wait = (self.wait * 2).min(backoff.most);
        Ok(())
    }

    /// What went missing so far.
    pub fn losses(&self) -> Losses {
        let now = match &self.state {
            State::Up { link, .. } => link.skipped(),
            State::Down { .. } => 0,
        };
        Losses { skipped_bytes: self.skipped + now, ..self.losses.losses }
    }

    /// How often it has connected again.
    pub fn reconnects(&self) -> u64 {
        self.reconnects
    }

    /// The address of this side; with UDP, where a daemon must send.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        match &self.state {
            State::Up { link, .. } => link.local_addr(),
            State::Down { .. } => Err(io::ErrorKind::NotConnected.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use trifacet_core::estimation::PoseReport;
    use trifacet_core::stamp::Stamp;
    use trifacet_core::time::Mono;
    use trifacet_wire::byte_order::big_endian;

    use super::*;

    fn frame(session: u32, sequence: u64) -> PoseFrame {
        let stamp = Stamp { session, config: 0, sequence, time_ns: 0, synced: true, sent: Mono(0) };
        PoseReport::example().frame(stamp)
    }

    #[tokio::test]
    async fn datagrams_are_read_and_others_counted() {
        let mut client = Client::connect(&"udp://127.0.0.1:0".parse().unwrap()).await.unwrap();
        let to = client.local_addr().unwrap();
        let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        let mut too_long = frame(1, 1).encode().to_vec();
        too_long.push(0);
        let good = frame(1, 2).encode();
        for bytes in [b"hello".as_slice(), &too_long, &good, &big_endian(&frame(1, 3).encode())] {
            socket.send_to(bytes, to).unwrap();
        }
        assert_eq!(client.next().await.unwrap(), Message::Pose(frame(1, 2)));
        assert_eq!(client.next().await.unwrap(), Message::Pose(frame(1, 3)));
        assert_eq!(client.losses().skipped_bytes, 5 + 193);
        let mut other = good;
        other[4] = 2;
        socket.send_to(&other, to).unwrap();
        let error = client.next().await.unwrap_err();
        assert!(error.to_string().contains("version 2.0"), "{error}");
    }
}
