//! Connections to a board over TCP and on Unix sockets.

use std::fs;
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use rustix::net::sockopt::{
    set_socket_keepalive, set_tcp_keepcnt, set_tcp_keepidle, set_tcp_keepintvl, set_tcp_nodelay,
    set_tcp_user_timeout,
};
use rustix::process::geteuid;

use crate::config::{Destination, Host};

/// Longest time to connect to one address.
const CONNECT: Duration = Duration::from_secs(2);
/// A connection whose other side confirms nothing for this time is closed, milliseconds. Silence is reported long
/// before; this frees the connection for another attempt.
const DEAD_MS: u32 = 3000;

/// Sets the options of a TCP connection between board and host: small messages leave at once, and a connection whose
/// cable was pulled ends by itself, also while this side sends nothing.
///
/// # Errors
/// The system refuses it.
pub fn set_options(stream: impl AsFd) -> io::Result<()> {
    let stream = stream.as_fd();
    set_tcp_nodelay(stream, true)?;
    set_socket_keepalive(stream, true)?;
    set_tcp_keepidle(stream, Duration::from_secs(1))?;
    set_tcp_keepintvl(stream, Duration::from_secs(1))?;
    set_tcp_keepcnt(stream, 3)?;
    Ok(set_tcp_user_timeout(stream, DEAD_MS)?)
}

/// Connects to a host. A name may have several addresses: the first that accepts is used.
pub(super) fn tcp(to: &Destination) -> Result<TcpStream, String> {
    let mut why = "the name has no address".to_owned();
    for address in addresses(to)? {
        match connected(address) {
            Ok(stream) => return Ok(stream),
            Err(error) => why = explained(&error),
        }
    }
    Err(why)
}

fn connected(address: SocketAddr) -> io::Result<TcpStream> {
    let stream = TcpStream::connect_timeout(&address, CONNECT)?;
    // Without a listener on this machine, the system may connect a socket to itself.
    if stream.local_addr()? == stream.peer_addr()? {
        return Err(ErrorKind::ConnectionRefused.into());
    }
    set_options(&stream)?;
    Ok(stream)
}

fn addresses(to: &Destination) -> Result<Vec<SocketAddr>, String> {
    let name = match &to.host {
        Host::Address(ip) => return Ok(vec![SocketAddr::new(*ip, to.port)]),
        Host::Zoned(ip, zone) => format!("{ip}%{zone}"),
        Host::Name(name) => name.clone(),
    };
    let found = (name.as_str(), to.port).to_socket_addrs();
    found.map(Iterator::collect).map_err(|error| format!("the host {name} cannot be found: {error}"))
}

fn explained(error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::ConnectionRefused => {
            "connection refused: no board listens there (is its program running, and is this its port?)"
                .into()
        }
        ErrorKind::TimedOut => format!(
            "no answer within {} s: is the host on, and does its firewall permit the connection?",
            CONNECT.as_secs()
        ),
        _ => error.to_string(),
    }
}

/// Connects to a socket of this machine.
pub(super) fn unix(path: &Path) -> Result<UnixStream, String> {
    UnixStream::connect(path).map_err(|error| match (error.kind(), fs::metadata(path)) {
        (ErrorKind::NotFound, _) => "the socket does not exist: is the program of the board running?".into(),
        (_, Ok(file)) if !file.file_type().is_socket() => "is not a socket".into(),
        (ErrorKind::ConnectionRefused, _) => {
            "connection refused: no program listens at this socket any more; start that of the board".into()
        }
        (ErrorKind::PermissionDenied, Ok(file)) => format!(
            "permission denied: this process runs as user {}, the socket belongs to user {} and group {} with mode \
             {:04o}; who connects needs the permission to write",
            geteuid().as_raw(),
            file.uid(),
            file.gid(),
            file.mode() & 0o7777
        ),
        (ErrorKind::PermissionDenied, Err(_)) => format!(
            "permission denied: this process runs as user {}, which may not enter the folder of the socket",
            geteuid().as_raw()
        ),
        _ => error.to_string(),
    })
}
