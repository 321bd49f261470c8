//! Opens the sockets of receivers. None of them blocks.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::os::fd::AsFd;

use rustix::net::{
    AddressFamily, SocketFlags, SocketType, bind, connect, connect_unspec, socket_with, sockopt,
};

use super::resolve::Resolved;
use crate::config::UdpTarget;

/// Opens the socket of a target. It stays unconnected: the system then chooses route and own address for each
/// datagram, so that sending continues by itself after a change of either.
///
/// # Errors
/// The system refuses the socket or one of its options.
pub fn open_target(target: &UdpTarget, resolved: Resolved) -> io::Result<UdpSocket> {
    let local: IpAddr = match resolved.to {
        SocketAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
    };
    let socket = UdpSocket::bind((local, 0))?;
    socket.set_nonblocking(true)?;
    match resolved.to.ip() {
        IpAddr::V4(group) if group.is_multicast() => {
            sockopt::set_ip_multicast_ttl(&socket, target.ttl.unwrap_or(1))?;
            if let Some(own) = target.interface.as_deref().and_then(|own| own.parse::<Ipv4Addr>().ok()) {
                sockopt::set_ip_multicast_if(&socket, &own)?;
            } else if let Some(number) = resolved.interface {
                let any = Ipv4Addr::UNSPECIFIED;
                sockopt::set_ip_multicast_if_with_ifindex(&socket, &group, &any, number)?;
            }
        }
        IpAddr::V4(_) => socket.set_broadcast(true)?,
        IpAddr::V6(group) if group.is_multicast() => {
            sockopt::set_ipv6_multicast_hops(&socket, target.ttl.unwrap_or(1))?;
            if let Some(number) = resolved.interface {
                sockopt::set_ipv6_multicast_if(&socket, number)?;
            }
        }
        IpAddr::V6(_) => {}
    }
    Ok(socket)
}

/// Opens the socket of a subscriber. It has the address and port of `server`, the socket for requests, so that
/// frames come from the port that was asked. Being connected, it also receives the further requests of this
/// subscriber; until then it may receive a request of any client.
///
/// # Errors
/// The system refuses the socket, or has no route to the subscriber.
pub fn open_subscriber(server: impl AsFd, own: SocketAddr, to: SocketAddr) -> io::Result<UdpSocket> {
    let family = if own.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let socket = socket_with(family, SocketType::DGRAM, SocketFlags::CLOEXEC | SocketFlags::NONBLOCK, None)?;
    sockopt::set_socket_reuseaddr(&socket, true)?;
    // Only at this moment: otherwise a second daemon could open the same port without an error.
    sockopt::set_socket_reuseaddr(&server, true)?;
    let bound = bind(&socket, &own);
    sockopt::set_socket_reuseaddr(&server, false)?;
    bound?;
    connect(&socket, &to)?;
    Ok(socket.into())
}

/// Chooses the own address of a subscriber's socket again: that of its connection may no longer exist.
///
/// # Errors
/// There is no route to the subscriber.
pub fn reconnect(socket: impl AsFd, to: SocketAddr) -> io::Result<()> {
    connect_unspec(&socket)?;
    Ok(connect(&socket, &to)?)
}
