//! Listeners: sockets to which clients come. They open although no interface has their address yet, and go on
//! after every error: too few file descriptors, a network that is down, a connection that ended before it was
//! accepted.

use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;
use std::{fs, io};

use rustix::net::sockopt::{set_ip_freebind, set_ipv6_freebind};
use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, socket_with};
use tokio::net::{TcpListener, TcpSocket};
use tokio::time::sleep;

/// Time between two attempts while the system refuses them. Clients wait in the queue of the system meanwhile.
const PAUSE: Duration = Duration::from_millis(100);

/// Connections that may wait to be accepted.
const BACKLOG: u32 = 1024;

/// Opens a listener for TCP clients. Must be called within a runtime.
///
/// # Errors
/// The system refuses it, for example because another process uses the port.
pub fn open_tcp(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    socket.set_reuseaddr(true)?;
    bound_early(&socket, address, || socket.bind(address))?;
    socket.listen(BACKLOG)
}

/// Opens a socket for datagrams of clients. It does not block.
///
/// # Errors
/// The system refuses it, for example because another process uses the port.
pub fn open_udp(address: SocketAddr) -> io::Result<UdpSocket> {
    let family = if address.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket: OwnedFd = socket_with(family, SocketType::DGRAM, flags, None)?;
    bound_early(&socket, address, || Ok(bind(&socket, &address)?))?;
    Ok(socket.into())
}

/// Removes the file of a Unix socket at which no process listens, so that it can be opened again. Other files stay, and
/// make opening fail.
///
/// # Errors
/// `AddrInUse` if a process listens there.
pub fn clear_unix(path: &Path) -> io::Result<()> {
    if !fs::symlink_metadata(path).is_ok_and(|file| file.file_type().is_socket()) {
        return Ok(());
    }
    match UnixStream::connect(path) {
        Ok(_) => Err(io::ErrorKind::AddrInUse.into()),
        Err(e) if e.kind() == io::ErrorKind::ConnectionRefused => {
            let _ = fs::remove_file(path); // if this fails, so does opening
            Ok(())
        }
        Err(_) => Ok(()),
    }
}

/// Binds a socket. If no interface has the address, as before the network is up, it is bound nevertheless:
/// clients reach it as soon as an interface has the address, without further action.
fn bound_early(socket: impl AsFd, address: SocketAddr, bind: impl Fn() -> io::Result<()>) -> io::Result<()> {
    match bind() {
        Err(e) if e.kind() == io::ErrorKind::AddrNotAvailable => {
            match address {
                SocketAddr::V4(_) => set_ip_freebind(socket, true)?,
                SocketAddr::V6(_) => set_ipv6_freebind(socket, true)?,
            }
            bind()?;
            tracing::warn!(%address, "no interface has this address at present: clients cannot reach it until one has");
            Ok(())
        }
        result => result,
    }
}

/// The state of a listener. The beginning of a failure and its end are logged once each.
#[derive(Debug)]
pub struct Accepting {
    what: &'static str,
    failures: u64,
}

impl Accepting {
    /// For a listener that accepts `what`, such as "a TCP client".
    pub fn new(what: &'static str) -> Self {
        Self { what, failures: 0 }
    }

    /// The accepted connection; `None` after an error, and after a pause: the next attempt is due.
    pub async fn taken<T>(&mut self, accepted: io::Result<T>) -> Option<T> {
        let what = self.what;
        match accepted {
            Ok(taken) => {
                if self.failures > 0 {
                    tracing::info!(failures = self.failures, "accepted {what} again");
                    self.failures = 0;
                }
                Some(taken)
            }
            Err(e) => {
                if self.failures == 0 {
                    tracing::warn!("cannot accept {what}, trying again: {e}");
                }
                self.failures += 1;
                sleep(PAUSE).await;
                None
            }
        }
    }
}
