//! Client of trifacet's pose stream: typed frames over TCP and UDP (`docs/stream.md`).
//!
//! A client resynchronises on a damaged stream, counts what is missing ([`Losses`]), and connects again if
//! [`Options::reconnect`] asks for it. [`Endpoint`] shows the forms of an address.
//!
//! ```
//! use trifacet_client::{Client, Message, PoseFrame};
//!
//! # #[tokio::main(flavor = "current_thread")]
//! # async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut client = Client::connect(&"udp://127.0.0.1:0".parse()?).await?;
//! # // A daemon in miniature: one frame to the port of this client.
//! # let to = client.local_addr()?;
//! # std::net::UdpSocket::bind("127.0.0.1:0")?.send_to(&PoseFrame::example().encode(), to)?;
//! if let Message::Pose(frame) = client.next().await? {
//!     println!("{} {:?}", frame.sequence, frame.pose); // metres and radians; NaN without POSE_VALID
//! #   assert_eq!(frame, PoseFrame::example());
//! }
//! # Ok(())
//! # }
//! ```

mod endpoint;
mod link;
mod losses;
mod period;

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
use self::period::FramePeriod;

/// A daemon sends a heartbeat every second, however rare frames are. After this time without a message the
/// link is considered dead, and a client with [`Options::reconnect`] connects again. On a subscription the
/// daemon confirms each renewal, thrice in a lease; there, the time is at least the lease.
const SILENCE: Duration = Duration::from_secs(5);

/// Options of a client.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Share of the frames. Applies to TCP and subscriptions; a subscription accepts a divider only. For UDP
    /// without a subscription the daemon's configuration decides.
    pub pace: Pace,
    /// Whether an invalid frame carries the last valid pose, with `POSE_HELD`, instead of NaN. Applies
    /// where `pace` does.
    pub held: bool,
    /// Interface that receives a multicast group: its name, or for IPv4 also its address.
    pub interface: Option<String>,
    /// Lease of a subscription after each renewal: 1 to 60 s.
    pub lease_s: u32,
    /// Delays of reconnecting after the stream has ended or broken; `None`: no reconnecting.
    pub reconnect: Option<Backoff>,
}

impl Default for Options {
    fn default() -> Self {
        Self { pace: Pace::default(), held: false, interface: None, lease_s: 10, reconnect: None }
    }
}

/// Delays before the attempts to reconnect. Each is twice the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Backoff {
    /// Before the first attempt.
    pub first: Duration,
    /// The longest delay.
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
    period: FramePeriod,
    /// Bytes skipped in earlier links.
    skipped: u64,
    reconnects: u64,
    /// Delay before the next attempt to reconnect.
    wait: Duration,
}

#[derive(Debug)]
enum State {
    Up { link: Link, last_arrival: Instant },
    Down { retry: Instant },
}

impl Client {
    /// Connects to a daemon and requests every frame, or opens the port to which a daemon sends. With UDP,
    /// success does not mean that a daemon is sending.
    ///
    /// # Errors
    /// [`ClientError::Open`] if the address cannot be opened, [`ClientError::Refused`] if the daemon refuses.
    pub async fn connect(endpoint: &Endpoint) -> Result<Self, ClientError> {
        Self::connect_with(endpoint, Options::default()).await
    }

    /// As [`Client::connect`], with options. There is one attempt only, whatever `reconnect` is: an address
    /// that never worked is an error.
    ///
    /// # Errors
    /// As [`Client::connect`]; also if a subscription is requested with a rate instead of a divider.
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
            state: State::Up { link, last_arrival: Instant::now() },
            losses: LossCounter::new(step),
            period: FramePeriod::default(),
            skipped: 0,
            reconnects: 0,
        })
    }

    /// The next message. Over TCP the first one is the descriptor; over UDP there are frames only.
    /// Damaged bytes are skipped and counted. Cancel-safe: dropping the future loses nothing.
    ///
    /// # Errors
    /// Every error is final. [`ClientError::Refused`] carries the reason for which a daemon
    /// refuses this client.
    /// With [`Options::reconnect`] the only errors are a refusal and a message that cannot be decoded, such
    /// as an unknown version; after any other failure this call connects again and waits for a message.
    pub async fn next(&mut self) -> Result<Message, ClientError> {
        loop {
            match self.step().await {
                Ok(Some(message)) => return Ok(message),
                Ok(None) => {}
                Err(e) => self.bear(e)?,
            }
        }
    }

    /// Does one step: reconnects, or receives a message or a confirmation of the subscription.
    async fn step(&mut self) -> Result<Option<Message>, ClientError> {
        match &mut self.state {
            State::Down { retry } => {
                sleep_until(*retry).await;
                let silent = |_| io::Error::new(io::ErrorKind::TimedOut, "no answer");
                let link =
                    timeout(SILENCE, Link::open(&self.endpoint, &self.options)).await.map_err(silent)??;
                self.state = State::Up { link, last_arrival: Instant::now() };
                self.reconnects += 1;
                self.period.restart();
                Ok(None)
            }
            State::Up { link, last_arrival } => {
                let message = if self.options.reconnect.is_some() && !matches!(link, Link::Udp { .. }) {
                    let silent = |_| io::Error::new(io::ErrorKind::TimedOut, "no message from the daemon");
                    let limit = match self.endpoint {
                        Endpoint::Subscribe(_) => {
                            SILENCE.max(Duration::from_secs(self.options.lease_s.into()))
                        }
                        _ => SILENCE,
                    };
                    timeout_at(*last_arrival + limit, link.next()).await.map_err(silent)??
                } else {
                    link.next().await?
                };
                *last_arrival = Instant::now();
                message.map(|message| self.note(message)).transpose()
            }
        }
    }

    fn note(&mut self, message: Message) -> Result<Message, ClientError> {
        match &message {
            Message::Pose(frame) => {
                self.losses.note(frame);
                self.period.frame();
                self.wait = self.options.reconnect.unwrap_or_default().first;
            }
            Message::Descriptor(descriptor) => {
                self.period.describe(descriptor);
                self.losses.step = descriptor.stream.as_ref().map(|stream| stream.divider.into());
            }
            Message::Refusal(Refusal { error }) => return Err(ClientError::Refused(error.clone())),
            Message::Heartbeat(_) | Message::Answer(_) => {}
        }
        Ok(message)
    }

    /// Schedules the next attempt after an error that reconnecting may cure; returns other errors.
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

    /// Losses so far.
    pub fn losses(&self) -> Losses {
        let now = match &self.state {
            State::Up { link, .. } => link.skipped(),
            State::Down { .. } => 0,
        };
        Losses { skipped_bytes: self.skipped + now, ..self.losses.losses }
    }

    /// The time between two frames, for limits on silence: over TCP from the descriptor, otherwise the longest
    /// of the last eight intervals. `None` before there are any.
    pub fn frame_period(&self) -> Option<Duration> {
        self.period.get()
    }

    /// Number of successful reconnections.
    pub fn reconnects(&self) -> u64 {
        self.reconnects
    }

    /// The local address; with UDP, the one to which a daemon must send.
    ///
    /// # Errors
    /// The client is not connected, or the system does not provide the address.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        match &self.state {
            State::Up { link, .. } => link.local_addr(),
            State::Down { .. } => Err(io::ErrorKind::NotConnected.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use trifacet_wire::byte_order::big_endian;

    use super::*;

    fn frame(session: u32, sequence: u64) -> PoseFrame {
        PoseFrame { session, sequence, ..PoseFrame::example() }
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
        assert!(error.to_string().contains("version 2.1"), "{error}");
    }
}
