//! The socket of an emulated board on a network. The board serves one host at a time; another one is told which host
//! has the board.

use std::fmt;
use std::future::poll_fn;
use std::io;
use std::net::SocketAddr;
use std::os::unix::net as blocking;
use std::path::PathBuf;
use std::pin::Pin;
use std::str::FromStr;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use rustix::net::sockopt::set_socket_send_buffer_size;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::{TcpListener, UnixListener};
use tokio::time::timeout;
use trifacet_core::time::Clock;
use trifacet_wire::board::Answer;

use super::Emulator;
use crate::board_link::{Wire, set_options};
use crate::config::Network;
use crate::listening::{Accepting, clear_unix, open_tcp};
use crate::serial_port::process;

/// Bytes of scans that the system keeps for a host that does not read: about a second at 1 kHz. Further scans fill the
/// buffer of the board, which then omits them.
const SEND_BUFFER: usize = 65_536;
/// Longest time until a refused host has read why.
const PARTING: Duration = Duration::from_secs(1);

/// Where a board listens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ListenAt {
    /// An address of this machine; port 0 stands for any free port.
    Tcp(SocketAddr),
    /// The path of a Unix socket.
    Unix(PathBuf),
}

/// A text that is not a [`ListenAt`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "allowed is an address of this machine and a port such as 127.0.0.1:7365 or [::1]:7365, or unix:PATH for a socket"
)]
pub struct ListenAtError;

impl FromStr for ListenAt {
    type Err = ListenAtError;

    fn from_str(text: &str) -> Result<Self, ListenAtError> {
        match text.strip_prefix("unix:") {
            Some("") => Err(ListenAtError),
            Some(path) => Ok(Self::Unix(path.into())),
            None => text.parse().map(Self::Tcp).map_err(|_| ListenAtError),
        }
    }
}

impl fmt::Display for ListenAt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => address.fmt(f),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

/// Why a host was turned away.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// Another host has the board.
    #[error("refused {host}: {holder} has the board")]
    Busy {
        /// The refused host.
        host: String,
        /// The other one.
        holder: String,
    },
    /// Its address is in none of the allowed networks.
    #[error("refused {host}: it is in no allowed network")]
    NotAllowed {
        /// The refused host.
        host: String,
    },
}

/// The socket of a board.
pub struct BoardSocket {
    listener: Listener,
    /// Networks from which hosts are accepted over TCP.
    allow: Vec<Network>,
    host: Option<Host>,
    accepting: Accepting,
    buffer: [u8; 1024],
}

enum Listener {
    Tcp(TcpListener),
    Unix(UnixListener, PathBuf),
}

/// A connected host.
struct Host {
    wire: Box<dyn Wire>,
    name: String,
    allowed: bool,
}

impl BoardSocket {
    /// Listens there, for hosts in these networks. Needs a tokio runtime.
    ///
    /// # Errors
    /// The system refuses it, for example because another process listens there.
    pub fn open(at: &ListenAt, allow: Vec<Network>) -> io::Result<Self> {
        let listener = match at {
            ListenAt::Tcp(address) => Listener::Tcp(open_tcp(*address)?),
            ListenAt::Unix(path) => {
                clear_unix(path)?;
                let listener = blocking::UnixListener::bind(path)?;
                listener.set_nonblocking(true)?;
                Listener::Unix(UnixListener::from_std(listener)?, path.clone())
            }
        };
        let accepting = Accepting::new("a host");
        Ok(Self { listener, allow, host: None, accepting, buffer: [0; 1024] })
    }

    /// Where it listens; with the port that the system has chosen.
    ///
    /// # Errors
    /// The system reports no address.
    pub fn place(&self) -> io::Result<ListenAt> {
        Ok(match &self.listener {
            Listener::Tcp(listener) => ListenAt::Tcp(listener.local_addr()?),
            Listener::Unix(_, path) => ListenAt::Unix(path.clone()),
        })
    }

    /// Transfers bytes between the host and the board until some have arrived, or a host comes or goes. Returns the
    /// reason if a host was turned away. Cancel-safe.
    pub async fn exchange(&mut self, board: &mut Emulator, clock: &impl Clock) -> Option<Refused> {
        let Self { listener, allow, host, accepting, buffer } = self;
        let Some(now) = host else {
            board.unheard();
            let accepted = listener.accept(allow).await;
            let new = accepting.taken(accepted).await?;
            if !new.allowed {
                return Some(Refused::NotAllowed { host: new.name });
            }
            *host = Some(new);
            return None;
        };
        tokio::select! {
            accepted = listener.accept(allow) => {
                let other = accepting.taken(accepted).await?;
                let (holder, host) = (now.name.clone(), other.name.clone());
                if !other.allowed {
                    return Some(Refused::NotAllowed { host });
                }
                tokio::spawn(turn_away(other.wire, holder.clone()));
                return Some(Refused::Busy { host, holder });
            }
            read = poll_fn(|cx| poll_exchange(&mut now.wire, buffer, board, cx)) => match read {
                Ok(read) if read > 0 => board.received(&buffer[..read], clock.now()),
                // Closed, or broken: the lease of its last command goes on.
                _ => *host = None,
            },
        }
        None
    }
}

impl Listener {
    /// The next host.
    async fn accept(&self, allow: &[Network]) -> io::Result<Host> {
        match self {
            Self::Tcp(listener) => {
                let (stream, address) = listener.accept().await?;
                set_options(&stream)?;
                set_socket_send_buffer_size(&stream, SEND_BUFFER)?;
                let allowed = allow.iter().any(|network| network.contains(address.ip()));
                Ok(Host { wire: Box::new(stream), name: address.to_string(), allowed })
            }
            Self::Unix(listener, _) => {
                let (stream, _) = listener.accept().await?;
                set_socket_send_buffer_size(&stream, SEND_BUFFER)?;
                let pid = stream.peer_cred()?.pid().and_then(|pid| u32::try_from(pid).ok());
                let name = pid.map_or("a process of this machine".into(), process);
                Ok(Host { wire: Box::new(stream), name, allowed: true })
            }
        }
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        if let Self::Unix(_, path) = self {
            let _ = std::fs::remove_file(path); // otherwise the next board replaces it
        }
    }
}

/// Tells a host who has the board, and closes the connection when it has read that.
async fn turn_away(mut wire: Box<dyn Wire>, holder: String) {
    let mut frame = Vec::new();
    Answer::Busy { host: holder }.encode(&mut frame);
    let _ = timeout(PARTING, async {
        wire.write_all(&frame).await?;
        wire.shutdown().await?;
        // Closing it with unread bytes would reset it, before the host has read the answer.
        while wire.read(&mut [0; 256]).await? > 0 {}
        io::Result::Ok(())
    })
    .await;
}

/// Reads if data is available; writes the output of the board.
fn poll_exchange(
    wire: &mut Box<dyn Wire>,
    buffer: &mut [u8],
    board: &mut Emulator,
    cx: &mut Context,
) -> Poll<io::Result<usize>> {
    let mut read = ReadBuf::new(buffer);
    if let Poll::Ready(done) = Pin::new(&mut *wire).poll_read(cx, &mut read) {
        return Poll::Ready(done.map(|()| read.filled().len()));
    }
    while !board.output().is_empty() {
        let written = ready!(Pin::new(&mut *wire).poll_write(cx, board.output()))?;
        board.written(written);
    }
    Poll::Pending
}
