//! Sends frames as datagrams to fixed targets and to subscribers, on the fast side.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::sync::Arc;

use rustix::net::netdevice::name_to_index;
use rustix::net::sockopt;
use tokio::sync::watch;
use trifacet_core::telemetry::Counters;
use trifacet_wire::PoseFrame;
use trifacet_wire::byte_order::big_endian;
use trifacet_wire::frame::FrameBytes;
use trifacet_wire::held::Hold;
use trifacet_wire::stream::Delivery;

use crate::config::UdpTarget;
use crate::exit::{self, Failure};

/// A receiver of datagrams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Subscriber {
    /// The address to which datagrams are sent.
    pub address: SocketAddr,
    /// Divider, byte order and held pose.
    pub delivery: Delivery,
}

/// The fast side's end of the subscription server: its socket and the current list of subscribers.
#[derive(Debug)]
pub struct Subscribers {
    link: Link,
    newest: watch::Receiver<Arc<[Subscriber]>>,
    current: Arc<[Subscriber]>,
}

/// All receivers of datagrams.
#[derive(Debug)]
pub struct Targets {
    fixed: Vec<Target>,
    subscribers: Option<Subscribers>,
    hold: Hold,
}

#[derive(Debug)]
struct Target {
    to: Subscriber,
    link: Link,
}

/// A socket and its state.
#[derive(Debug)]
struct Link {
    socket: UdpSocket,
    /// The last send failed. Each change of this flag is logged once.
    failing: bool,
}

impl Subscribers {
    /// Subscribers from a list that changes. Frames are sent from `socket`, which received the requests.
    pub fn new(socket: UdpSocket, newest: watch::Receiver<Arc<[Subscriber]>>) -> Self {
        Self { link: Link { socket, failing: false }, newest, current: [].into() }
    }

    fn send(&mut self, forms: &mut Forms<'_>, counters: &Counters) {
        // This check only reads an atomic; the lock is taken on a change. A closed channel changes nothing.
        if self.newest.has_changed().unwrap_or(false) {
            self.current = Arc::clone(&self.newest.borrow_and_update());
        }
        for to in self.current.iter() {
            self.link.send(to, forms, counters);
        }
    }
}

impl Targets {
    /// Opens a socket for each target.
    ///
    /// # Errors
    /// A socket cannot be opened or configured.
    pub fn open(fixed: &[UdpTarget], subscribers: Option<Subscribers>) -> Result<Self, Failure> {
        let fixed = fixed.iter().map(Target::open).collect::<Result<_, _>>()?;
        Ok(Self { fixed, subscribers, hold: Hold::default() })
    }

    /// Sends a frame to all targets and subscribers that are due for it. Never waits: what the network does
    /// not accept is counted in `counters`.
    pub fn send(&mut self, frame: &PoseFrame, counters: &Counters) {
        let mut forms = Forms::new(frame, self.hold.next(frame));
        for Target { to, link } in &mut self.fixed {
            link.send(to, &mut forms, counters);
        }
        if let Some(subscribers) = &mut self.subscribers {
            subscribers.send(&mut forms, counters);
        }
    }
}

/// The encodings of one frame. Each is made once, when a receiver first needs it.
struct Forms<'a> {
    frame: &'a PoseFrame,
    held: Option<PoseFrame>,
    made: [Option<FrameBytes>; 4],
}

impl<'a> Forms<'a> {
    fn new(frame: &'a PoseFrame, held: Option<PoseFrame>) -> Self {
        Self { frame, held, made: [None; 4] }
    }

    fn get(&mut self, delivery: Delivery) -> &FrameBytes {
        let held = self.held.as_ref().filter(|_| delivery.held);
        let frame = held.unwrap_or(self.frame);
        let which = usize::from(held.is_some()) * 2 + usize::from(delivery.big_endian);
        self.made[which].get_or_insert_with(|| {
            let little = frame.encode();
            if delivery.big_endian { big_endian(&little) } else { little }
        })
    }
}

impl Target {
    /// Opens a socket for this target. It stays unconnected: a refusal by a host without a listener then
    /// causes no error, and a listener that starts later receives datagrams.
    fn open(target: &UdpTarget) -> Result<Self, Failure> {
        let UdpTarget { address, divider, big_endian, held, .. } = *target;
        let socket = open(target).map_err(|e| {
            let through = target.interface.as_ref().map_or(String::new(), |i| format!(" through {i}"));
            Failure::new(exit::IO, format!("cannot open a UDP socket towards {address}{through}: {e}"))
        })?;
        let to = Subscriber { address, delivery: Delivery { divider, big_endian, held } };
        Ok(Self { to, link: Link { socket, failing: false } })
    }
}

fn open(target: &UdpTarget) -> io::Result<UdpSocket> {
    let local: IpAddr = match target.address {
        SocketAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
    };
    let socket = UdpSocket::bind((local, 0))?;
    socket.set_nonblocking(true)?;
    socket.set_broadcast(target.address.is_ipv4())?;
    match target.address.ip() {
        IpAddr::V4(group) if group.is_multicast() => {
            sockopt::set_ip_multicast_ttl(&socket, target.ttl.unwrap_or(1))?;
            match target.interface.as_deref().map(|i| (i, i.parse::<Ipv4Addr>())) {
                Some((_, Ok(own))) => sockopt::set_ip_multicast_if(&socket, &own)?,
                Some((name, Err(_))) => {
                    let index = name_to_index(&socket, name)?;
                    let any = Ipv4Addr::UNSPECIFIED;
                    sockopt::set_ip_multicast_if_with_ifindex(&socket, &group, &any, index)?;
                }
                None => {}
            }
        }
        IpAddr::V6(group) if group.is_multicast() => {
            sockopt::set_ipv6_multicast_hops(&socket, target.ttl.unwrap_or(1))?;
            if let Some(name) = &target.interface {
                sockopt::set_ipv6_multicast_if(&socket, name_to_index(&socket, name)?)?;
            }
        }
        _ => {}
    }
    Ok(socket)
}

impl Link {
    fn send(&mut self, to: &Subscriber, forms: &mut Forms<'_>, counters: &Counters) {
        let Subscriber { address, delivery } = to;
        if !forms.frame.sequence.is_multiple_of(delivery.divider.into()) {
            return;
        }
        let failure = match self.socket.send_to(forms.get(*delivery), address) {
            Ok(_) => None,
            Err(e) if e.kind() == io::ErrorKind::ConnectionRefused => None,
            Err(e) => Some(e),
        };
        if failure.is_some() {
            counters.udp_dropped.inc();
        }
        match (self.failing, failure) {
            (false, Some(e)) => {
                self.failing = true;
                tracing::warn!(target = %address, "cannot send datagrams (counted in udp_dropped): {e}");
            }
            (true, None) => {
                self.failing = false;
                tracing::info!(target = %address, "sending datagrams again");
            }
            _ => {}
        }
    }
}
