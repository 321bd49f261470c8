//! Asks the kernel whether datagrams can leave towards an address. The system accepts datagrams, and drops
//! them without an error, while the next hop does not answer address resolution or the cable is unplugged.
//!
//! The messages are those of rtnetlink(7): a request for the route, the link, and the neighbour.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::os::fd::OwnedFd;

use rustix::net::{AddressFamily, RecvFlags, SendFlags, SocketFlags, SocketType, recv, send, socket_with};

use super::cause::Cause;

const GET_LINK: u16 = 18;
const GET_ROUTE: u16 = 26;
const GET_NEIGHBOUR: u16 = 30;
const ERROR: u16 = 2;
const REQUEST: u16 = 1;
/// Length of the header of every message.
const HEADER: usize = 16;
/// A route to another host, not to this machine or to a group.
const UNICAST: u8 = 1;
/// The interface has a carrier.
const LOWER_UP: u32 = 1 << 16;
/// States of a neighbour that has not answered: incomplete and failed.
const UNRESOLVED: u16 = 0x01 | 0x20;

/// A socket for questions to the kernel.
#[derive(Debug)]
pub struct Paths {
    socket: OwnedFd,
    sequence: u32,
}

impl Paths {
    /// Opens the socket.
    ///
    /// # Errors
    /// The system refuses it, for example because of `RestrictAddressFamilies=` in the unit.
    pub fn open() -> io::Result<Self> {
        let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
        Ok(Self { socket: socket_with(AddressFamily::NETLINK, SocketType::RAW, flags, None)?, sequence: 0 })
    }

    /// What prevents datagrams to this address from leaving, although the system accepts them. `interface` is
    /// the number of the interface that is configured. `None` if there is no obstacle or if it is unknown.
    pub fn obstacle(&mut self, to: SocketAddr, interface: Option<u32>) -> Option<Cause> {
        let ip = to.ip().to_canonical();
        let zone = match to {
            SocketAddr::V6(to) if to.scope_id() != 0 => Some(to.scope_id()),
            _ => interface,
        };
        let route = self.route(ip, zone)?;
        let (name, carrier) = self.link(route.interface)?;
        if !carrier {
            return Some(Cause::NoLink { interface: name });
        }
        let host = route.gateway.unwrap_or(ip);
        let unresolved = route.unicast && self.unresolved(host, route.interface)?;
        unresolved.then(|| Cause::NoAnswer { host, gateway: host != ip, interface: name })
    }

    fn route(&mut self, to: IpAddr, interface: Option<u32>) -> Option<Route> {
        let bits = if to.is_ipv4() { 32 } else { 128 };
        let mut body = vec![family(to), bits, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        attribute(&mut body, 1, &octets(to));
        if let Some(number) = interface {
            attribute(&mut body, 4, &number.to_ne_bytes());
        }
        let answer = self.ask(GET_ROUTE, &body)?;
        let (unicast, attributes) = (*answer.get(7)? == UNICAST, answer.get(12..)?);
        let interface = u32::from_ne_bytes(find(attributes, 4)?.try_into().ok()?);
        Some(Route { interface, gateway: find(attributes, 5).and_then(from_octets), unicast })
    }

    /// Name of an interface, and whether it has a carrier.
    fn link(&mut self, number: u32) -> Option<(String, bool)> {
        let mut body = [0; 16];
        body[4..8].copy_from_slice(&number.to_ne_bytes());
        let answer = self.ask(GET_LINK, &body)?;
        let flags = u32::from_ne_bytes(answer.get(8..12)?.try_into().ok()?);
        let name = find(answer.get(16..)?, 3)?;
        let name = String::from_utf8_lossy(name).trim_end_matches('\0').to_owned();
        Some((name, flags & LOWER_UP != 0))
    }

    /// Whether a neighbour has not answered. The kernel knows only those to which something was sent.
    fn unresolved(&mut self, host: IpAddr, interface: u32) -> Option<bool> {
        let mut body = vec![family(host), 0, 0, 0];
        body.extend(interface.to_ne_bytes());
        body.extend([0; 4]);
        attribute(&mut body, 1, &octets(host));
        let answer = self.ask(GET_NEIGHBOUR, &body)?;
        Some(u16::from_ne_bytes(answer.get(8..10)?.try_into().ok()?) & UNRESOLVED != 0)
    }

    /// The answer without its header. The kernel answers before `send` returns.
    fn ask(&mut self, kind: u16, body: &[u8]) -> Option<Vec<u8>> {
        self.sequence = self.sequence.wrapping_add(1);
        let mut message = ((HEADER + body.len()) as u32).to_ne_bytes().to_vec();
        message.extend([kind, REQUEST].map(u16::to_ne_bytes).as_flattened());
        message.extend([self.sequence, 0].map(u32::to_ne_bytes).as_flattened());
        message.extend(body);
        send(&self.socket, &message, SendFlags::empty()).ok()?;
        let mut bytes = vec![0; 16 * 1024]; // a description of a link has some kilobytes
        loop {
            let (_, n) = recv(&self.socket, &mut bytes, RecvFlags::empty()).ok()?;
            let answer = bytes.get(..n)?;
            if answer.get(8..12)? == self.sequence.to_ne_bytes() {
                let failed = answer.get(4..6)? == ERROR.to_ne_bytes();
                return (!failed).then(|| answer.get(HEADER..).map(<[u8]>::to_vec))?;
            }
        }
    }
}

struct Route {
    interface: u32,
    gateway: Option<IpAddr>,
    unicast: bool,
}

fn family(of: IpAddr) -> u8 {
    let family = if of.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    family.as_raw() as u8
}

fn octets(of: IpAddr) -> Vec<u8> {
    match of {
        IpAddr::V4(ip) => ip.octets().to_vec(),
        IpAddr::V6(ip) => ip.octets().to_vec(),
    }
}

fn from_octets(bytes: &[u8]) -> Option<IpAddr> {
    let v4 = <[u8; 4]>::try_from(bytes).map(IpAddr::from);
    v4.or_else(|_| <[u8; 16]>::try_from(bytes).map(IpAddr::from)).ok()
}

/// Appends an attribute: length, type, value, padded to four bytes.
fn attribute(to: &mut Vec<u8>, kind: u16, value: &[u8]) {
    to.extend([4 + value.len() as u16, kind].map(u16::to_ne_bytes).as_flattened());
    to.extend(value);
    to.resize(to.len().next_multiple_of(4), 0);
}

/// The value of an attribute.
fn find(mut attributes: &[u8], kind: u16) -> Option<&[u8]> {
    loop {
        let (head, _) = attributes.split_first_chunk::<4>()?;
        let [a, b, c, d] = *head;
        let length = usize::from(u16::from_ne_bytes([a, b]));
        let value = attributes.get(4..length)?;
        if u16::from_ne_bytes([c, d]) == kind {
            return Some(value);
        }
        attributes = attributes.get(length.next_multiple_of(4)..)?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_is_always_within_reach() {
        let mut paths = Paths::open().unwrap();
        let route = paths.route([127, 0, 0, 1].into(), None).unwrap();
        assert!(!route.unicast && route.gateway.is_none());
        assert_eq!(paths.link(route.interface), Some(("lo".into(), true)));
        assert_eq!(paths.obstacle(([127, 0, 0, 1], 9).into(), None), None);
        assert_eq!(paths.link(4_000_000), None, "the error of an interface that does not exist is no answer");
        assert_eq!(paths.link(route.interface), Some(("lo".into(), true)));
    }

    #[test]
    fn damaged_attributes_are_not_read() {
        let mut attributes = Vec::new();
        attribute(&mut attributes, 7, &[1]);
        attribute(&mut attributes, 4, &[5, 6, 7, 8]);
        assert_eq!((find(&attributes, 7), find(&attributes, 4)), (Some(&[1][..]), Some(&[5, 6, 7, 8][..])));
        assert_eq!(find(&attributes, 9), None);
        for end in 0..attributes.len() {
            assert_eq!(find(&attributes[..end], 4), None);
        }
        assert_eq!(find(&[0; 64], 1), None, "a length of zero");
    }
}
