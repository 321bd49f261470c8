//! What the emulated board is connected to: a pseudo-terminal, or a socket on a network.

use std::path::PathBuf;

use anyhow::Context;
use trifacet::config::Network;
use trifacet::core::time::Clock;
use trifacet::exit::{Failure, USAGE};
use trifacet::twin::board_socket::Refused;
use trifacet::twin::{BoardSocket, Emulator, ListenAt, Pty};

use super::link::Link;

/// The kind of port, for each time that the cable is plugged in.
pub(super) enum Outlet {
    /// A pseudo-terminal, with a symbolic link to it.
    Pty { link: Option<PathBuf> },
    /// A socket.
    Socket { at: ListenAt, allow: Vec<Network> },
}

/// The port while the cable is plugged in.
pub(super) enum Port {
    Pty(Pty, #[expect(dead_code, reason = "removes the link")] Option<Link>),
    Socket(BoardSocket),
}

impl Outlet {
    /// The outlet of the command line.
    ///
    /// # Errors
    /// Other machines could reach the address, and no network is allowed; or the socket has no network.
    pub(super) fn new(
        listen: Option<ListenAt>,
        link: Option<PathBuf>,
        allow: &[Network],
    ) -> Result<Self, Failure> {
        let usage = |why: String| Err(Failure::new(USAGE, why));
        match listen {
            None => Ok(Self::Pty { link }),
            Some(ListenAt::Tcp(address)) if allow.is_empty() && !address.ip().is_loopback() => {
                usage(format!(
                    "--listen {address}: other machines may reach this address; add --allow NETWORK for those that may \
                 use the board, or listen at 127.0.0.1"
                ))
            }
            Some(ListenAt::Unix(_)) if !allow.is_empty() => {
                usage("--allow is for hosts over TCP; a Unix socket is protected by its folder".into())
            }
            Some(at) if allow.is_empty() => Ok(Self::Socket { at, allow: Network::loopback() }),
            Some(at) => Ok(Self::Socket { at, allow: allow.to_vec() }),
        }
    }

    /// Opens the port; returns it and its name for hosts.
    pub(super) fn open(&mut self) -> anyhow::Result<(Port, String)> {
        match self {
            Self::Pty { link } => {
                let pty = Pty::open().context("cannot create a pseudo-terminal")?;
                let link = link.as_deref().map(|link| Link::new(link, pty.path())).transpose()?;
                let name = pty.path().display().to_string();
                Ok((Port::Pty(pty, link), name))
            }
            Self::Socket { at, allow } => {
                let socket = BoardSocket::open(at, allow.clone())
                    .map_err(|error| Failure::port(format_args!("listen on {at}"), &error))?;
                *at = socket.place()?; // the same one when the cable is plugged in again
                Ok((Port::Socket(socket), at.to_string()))
            }
        }
    }
}

impl Port {
    /// Carries bytes until some have arrived. Returns the reason if a host was turned away.
    pub(super) async fn exchange(
        &mut self,
        board: &mut Emulator,
        clock: &impl Clock,
    ) -> anyhow::Result<Option<Refused>> {
        match self {
            Self::Pty(pty, _) => {
                pty.exchange(board, clock).await.context("the pseudo-terminal failed")?;
                Ok(None)
            }
            Self::Socket(socket) => Ok(socket.exchange(board, clock).await),
        }
    }
}
