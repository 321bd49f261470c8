//! Why datagrams do not reach a receiver.

use std::io;
use std::net::IpAddr;

/// A cause, with the text for log and status.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Cause {
    /// The name of the host has no address at present.
    #[error("the name {name} cannot be resolved: {why}")]
    Name {
        /// The name.
        name: String,
        /// The error of the resolver.
        why: String,
    },
    /// The name is being resolved for the first time.
    #[error("the name {0} is not resolved yet: the resolver of the system has not answered")]
    Pending(String),
    /// An interface of this name does not exist at present.
    #[error("there is no interface {0}")]
    Interface(String),
    /// The address needs a zone.
    #[error("{0} is valid on one interface only: write the name of the interface, as in [{0}%eth0]")]
    Zone(IpAddr),
    /// The socket cannot be opened.
    #[error("cannot open a socket: {}", io::Error::from_raw_os_error(*.0))]
    Socket(i32),
    /// The interface has no carrier.
    #[error("the interface {interface} has no link: check the cable")]
    NoLink {
        /// Name of the interface.
        interface: String,
    },
    /// The next hop does not answer address resolution (ARP or neighbour discovery).
    #[error("{} {host} does not answer on {interface}: it is off, disconnected, or has another address",
            if *.gateway { "the gateway" } else { "the host" })]
    NoAnswer {
        /// The address that does not answer.
        host: IpAddr,
        /// Whether it is a gateway on the way to the receiver.
        gateway: bool,
        /// Name of the interface.
        interface: String,
    },
    /// The send buffer of the socket is full.
    #[error("the send buffer is full: the network transmits fewer datagrams than the daemon sends")]
    Full,
    /// The system refused a datagram with this error number.
    #[error("{}", io::Error::from_raw_os_error(*.0))]
    Refused(i32),
}

impl Cause {
    /// The cause of a failed transmission.
    pub fn of_send(errno: i32) -> Self {
        match io::Error::from_raw_os_error(errno).kind() {
            io::ErrorKind::WouldBlock => Self::Full,
            _ => Self::Refused(errno),
        }
    }
}
