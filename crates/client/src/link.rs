//! The three transports of a client: TCP, datagrams sent to a configured address, and subscribed datagrams.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::Duration;

use rustix::net::netdevice::name_to_index;
use rustix::net::{AddressFamily, SocketType, bind, socket, sockopt};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, UdpSocket, lookup_host};
use tokio::time::{Instant, sleep_until, timeout};
use trifacet_wire::layout::FRAME_SIZE;
use trifacet_wire::stream::{
    Decoder, Delivery, Format, Message, MessageError, Pace, StreamRequest, SubscriptionRequest,
};
use trifacet_wire::{FrameError, PoseFrame};

use super::{ClientError, Endpoint, Options};

/// Receive buffer in bytes. The default of Linux holds 256 frames, which is 26 ms at 10 kHz.
const RECEIVE_BUFFER: usize = 1024 * 1024;
/// Time without an answer after which a request for a subscription is repeated, up to `ATTEMPTS` times.
const ANSWER: Duration = Duration::from_millis(300);
const ATTEMPTS: u32 = 5;
/// Prefix of the line that a daemon sends instead of a stream when it refuses a client.
const ERROR: &[u8] = b"error: ";
const LONGEST_REFUSAL: usize = 4096;

#[derive(Debug)]
pub(super) enum Link {
    Tcp { stream: TcpStream, decoder: Decoder, opened: bool },
    Udp { socket: UdpSocket, skipped: u64 },
    Subscribed(Subscribed),
}

impl Link {
    pub(super) async fn open(endpoint: &Endpoint, options: &Options) -> Result<Self, ClientError> {
        let failed = |source| ClientError::Open { endpoint: endpoint.clone(), source };
        match endpoint {
            Endpoint::Tcp(place) => open_tcp(place, options).await.map_err(failed),
            Endpoint::Udp(place) => {
                let socket = open_udp(place, options).await.map_err(failed)?;
                Ok(Self::Udp { socket, skipped: 0 })
            }
            Endpoint::Subscribe(place) => {
                let mut subscribed = Subscribed::ask(place, options).await.map_err(failed)?;
                match subscribed.granted().await {
                    Err(ClientError::Broken(source)) => Err(failed(source)),
                    result => result.map(|()| Self::Subscribed(subscribed)),
                }
            }
        }
    }

    /// The next message, or `None` if the daemon only confirmed the subscription.
    pub(super) async fn next(&mut self) -> Result<Option<Message>, ClientError> {
        match self {
            Self::Tcp { stream, decoder, opened } => next_tcp(stream, decoder, opened).await.map(Some),
            Self::Udp { socket, skipped } => loop {
                // One byte more than a frame, so that a longer datagram is not taken for one.
                let mut bytes = [0; FRAME_SIZE + 1];
                let n = socket.recv(&mut bytes).await?;
                if let Some(frame) = frame(&bytes[..n], skipped)? {
                    return Ok(Some(frame));
                }
            },
            Self::Subscribed(subscribed) => subscribed.next().await,
        }
    }

    pub(super) fn skipped(&self) -> u64 {
        match self {
            Self::Tcp { decoder, .. } => decoder.skipped(),
            Self::Udp { skipped, .. } | Self::Subscribed(Subscribed { skipped, .. }) => *skipped,
        }
    }

    pub(super) fn local_addr(&self) -> io::Result<SocketAddr> {
        match self {
            Self::Tcp { stream, .. } => stream.local_addr(),
            Self::Udp { socket, .. } | Self::Subscribed(Subscribed { socket, .. }) => socket.local_addr(),
        }
    }
}

async fn open_tcp(place: &str, options: &Options) -> io::Result<Link> {
    let mut stream = TcpStream::connect(place).await?;
    stream.set_nodelay(true)?;
    let Options { pace, held, events, .. } = *options;
    let request = StreamRequest { format: Format::Binary, pace, fields: None, held, events };
    stream.write_all(format!("{request}\n").as_bytes()).await?;
    Ok(Link::Tcp { stream, decoder: Decoder::default(), opened: false })
}

async fn next_tcp(
    stream: &mut TcpStream,
    decoder: &mut Decoder,
    opened: &mut bool,
) -> Result<Message, ClientError> {
    loop {
        if !*opened {
            // A stream begins with a message, a refusal is a line of text.
            let bytes = decoder.room();
            let text = bytes.len().min(ERROR.len());
            if bytes[..text] != ERROR[..text] || bytes.len() > LONGEST_REFUSAL {
                *opened = true;
            } else if let Some(end) = bytes.iter().position(|b| *b == b'\n') {
                let line = bytes[..end].trim_ascii().strip_prefix(ERROR).unwrap_or_default();
                return Err(ClientError::Refused(String::from_utf8_lossy(line).into_owned()));
            }
        }
        if *opened && let Some(message) = decoder.next_message() {
            return Ok(message?);
        }
        if stream.read_buf(decoder.room()).await? == 0 {
            return Err(ClientError::Closed);
        }
    }
}

async fn open_udp(place: &str, options: &Options) -> io::Result<UdpSocket> {
    let addresses: Vec<SocketAddr> = lookup_host(place).await?.collect();
    let socket = match addresses[..] {
        [group, ..] if group.ip().is_multicast() => join(group, options.interface.as_deref())?,
        _ => UdpSocket::bind(&addresses[..]).await?,
    };
    // The kernel grants at most net.core.rmem_max and reports no error.
    sockopt::set_socket_recv_buffer_size(&socket, RECEIVE_BUFFER)?;
    Ok(socket)
}

/// A socket that receives a multicast group and shares its port with other sockets.
fn join(group: SocketAddr, interface: Option<&str>) -> io::Result<UdpSocket> {
    let family = if group.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let own = socket(family, SocketType::DGRAM, None)?;
    sockopt::set_socket_reuseaddr(&own, true)?;
    bind(&own, &group)?;
    match (group.ip(), interface) {
        (IpAddr::V4(group), Some(name)) if name.parse::<Ipv4Addr>().is_err() => {
            let index = name_to_index(&own, name)?;
            sockopt::set_ip_add_membership_with_ifindex(&own, &group, &Ipv4Addr::UNSPECIFIED, index)?;
        }
        (IpAddr::V4(group), interface) => {
            let through = interface.and_then(|i| i.parse().ok()).unwrap_or(Ipv4Addr::UNSPECIFIED);
            sockopt::set_ip_add_membership(&own, &group, &through)?;
        }
        (IpAddr::V6(group), interface) => {
            let index = interface.map_or(Ok(0), |name| name_to_index(&own, name))?;
            sockopt::set_ipv6_add_membership(&own, &group, index)?;
        }
    }
    let socket = std::net::UdpSocket::from(own);
    socket.set_nonblocking(true)?;
    UdpSocket::from_std(socket)
}

/// Decodes the frame of a datagram. Bytes of other datagrams are counted in `skipped`.
fn frame(bytes: &[u8], skipped: &mut u64) -> Result<Option<Message>, ClientError> {
    match PoseFrame::decode_either(bytes) {
        Ok(frame) => Ok(Some(Message::Pose(frame))),
        Err(FrameError::Version { major, minor }) => Err(MessageError::Version { major, minor }.into()),
        Err(_) => {
            *skipped += bytes.len() as u64;
            Ok(None)
        }
    }
}

/// A subscription. Reading renews it; dropping it ends it.
#[derive(Debug)]
pub(super) struct Subscribed {
    socket: UdpSocket,
    lease: Duration,
    delivery: Delivery,
    nonce: Option<u64>,
    renew: Instant,
    skipped: u64,
}

/// A datagram from the daemon.
#[expect(clippy::large_enum_variant, reason = "one at a time, and most are frames")]
enum Said {
    Granted,
    Challenge,
    Frame(Message),
    Nothing,
}

impl Subscribed {
    /// Opens a socket for the subscription.
    async fn ask(place: &str, options: &Options) -> io::Result<Self> {
        let daemon = lookup_host(place).await?.next();
        let daemon = daemon.ok_or_else(|| io::Error::from(io::ErrorKind::NotFound))?;
        let any: IpAddr = if daemon.is_ipv4() { [0; 4].into() } else { [0; 16].into() };
        let socket = UdpSocket::bind((any, 0)).await?;
        sockopt::set_socket_recv_buffer_size(&socket, RECEIVE_BUFFER)?;
        socket.connect(daemon).await?;
        let divider = match options.pace {
            Pace::Divider(divider) => divider,
            Pace::RateHz(_) => {
                return Err(io::Error::new(
                    io::ErrorKind::InvalidInput,
                    "a subscription takes a divider, not a rate",
                ));
            }
        };
        let delivery = Delivery { divider, big_endian: false, held: options.held };
        let lease = Duration::from_secs(options.lease_s.into());
        Ok(Self { socket, lease, delivery, nonce: None, renew: Instant::now(), skipped: 0 })
    }

    /// Sends the request until the daemon has granted it.
    async fn granted(&mut self) -> Result<(), ClientError> {
        for _ in 0..ATTEMPTS {
            self.say().await?;
            loop {
                match timeout(ANSWER, self.hear()).await {
                    Ok(Ok(Said::Granted)) => return Ok(()),
                    Ok(Ok(Said::Challenge)) => self.say().await?,
                    Ok(Ok(_)) => {}
                    Ok(Err(e)) => return Err(e),
                    Err(_) => break,
                }
            }
        }
        Err(io::Error::new(io::ErrorKind::TimedOut, "no answer").into())
    }

    /// Sends the request, or renews it.
    async fn say(&mut self) -> io::Result<()> {
        let lease_s = self.lease.as_secs() as u32;
        let ask = SubscriptionRequest::Subscribe { lease_s, delivery: self.delivery, nonce: self.nonce };
        self.renew = Instant::now() + self.lease / 3;
        self.socket.send(ask.to_string().as_bytes()).await.map(|_| ())
    }

    async fn hear(&mut self) -> Result<Said, ClientError> {
        let mut bytes = [0; FRAME_SIZE + 1];
        let n = self.socket.recv(&mut bytes).await?;
        let text = std::str::from_utf8(&bytes[..n]).unwrap_or_default();
        if text.starts_with("ok ") {
            return Ok(Said::Granted);
        }
        if let Some(why) = text.strip_prefix("error: ") {
            return Err(ClientError::Refused(why.to_owned()));
        }
        if let Some(nonce) = text.strip_prefix("challenge nonce=") {
            self.nonce = u64::from_str_radix(nonce, 16).ok();
            return Ok(Said::Challenge);
        }
        Ok(frame(&bytes[..n], &mut self.skipped)?.map_or(Said::Nothing, Said::Frame))
    }

    async fn next(&mut self) -> Result<Option<Message>, ClientError> {
        loop {
            let renew = self.renew;
            tokio::select! {
                biased;
                () = sleep_until(renew) => self.say().await?,
                said = self.hear() => match said? {
                    Said::Granted => return Ok(None),
                    Said::Challenge => self.say().await?,
                    Said::Frame(message) => return Ok(Some(message)),
                    Said::Nothing => {}
                },
            }
        }
    }
}

impl Drop for Subscribed {
    fn drop(&mut self) {
        if let Some(nonce) = self.nonce {
            // If this datagram is lost, the lease expires.
            let _ = self.socket.try_send(SubscriptionRequest::Unsubscribe { nonce }.to_string().as_bytes());
        }
    }
}
