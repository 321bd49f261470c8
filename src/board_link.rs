//! The link to a board: a serial port, a TCP connection or a Unix socket. What uses it does not know which.

mod network;

use std::fmt::Debug;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixStream;
use std::time::Duration;

pub use network::set_options;
use serialport::{SerialPort, TTYPort};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_serial::SerialStream;

use crate::config::BoardPlace;
use crate::serial_port::{self, Identity, PortError};

/// Why a link cannot be opened.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LinkError {
    /// The serial port cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// There is no connection.
    #[error("{place}: {reason}")]
    Connect {
        /// The address or the socket.
        place: String,
        /// What is wrong, and the usual cause.
        reason: String,
    },
}

impl LinkError {
    /// Whether another process of this machine has the link.
    pub fn is_in_use(&self) -> bool {
        matches!(self, Self::Port(PortError::InUse { .. }))
    }

    /// The reason, without the place.
    pub fn reason(&self) -> String {
        match self {
            Self::Port(error) => error.reason(),
            Self::Connect { reason, .. } => reason.clone(),
        }
    }
}

/// An open link: blocking, and independent of a runtime.
#[derive(Debug)]
pub enum Link {
    /// A serial port.
    Serial(TTYPort),
    /// A connection to a host.
    Tcp(TcpStream),
    /// A connection on this machine.
    Unix(UnixStream),
}

/// A link that is registered with a runtime.
pub trait Wire: AsyncRead + AsyncWrite + Debug + Send + Unpin {}
impl<T: AsyncRead + AsyncWrite + Debug + Send + Unpin> Wire for T {}

/// Opens the link to a board. Blocks while the system opens it, over a network for some seconds at most, and while a
/// name is resolved. `device`: what is known of the device that was at a serial port last; updated.
///
/// # Errors
/// A serial port as [`serial_port::open`]. Over a network: the name is unknown, or nothing accepts the connection.
pub fn open(place: &BoardPlace, device: &mut Identity) -> Result<Link, LinkError> {
    let failed = |reason| LinkError::Connect { place: place.to_string(), reason };
    match place {
        BoardPlace::Serial { port, baud } => {
            let opened = serial_port::open(port, *baud, device)?;
            *device = opened.identity;
            Ok(Link::Serial(opened.tty))
        }
        BoardPlace::Tcp(address) => network::tcp(address).map(Link::Tcp).map_err(failed),
        BoardPlace::Unix(path) => network::unix(path).map(Link::Unix).map_err(failed),
    }
}

impl Link {
    /// Registers the link with the runtime, within which this must be called.
    ///
    /// # Errors
    /// The system refuses it.
    pub fn into_wire(self) -> io::Result<Box<dyn Wire>> {
        Ok(match self {
            Self::Serial(port) => Box::new(SerialStream::try_from(port)?),
            Self::Tcp(stream) => {
                stream.set_nonblocking(true)?;
                Box::new(tokio::net::TcpStream::from_std(stream)?)
            }
            Self::Unix(stream) => {
                stream.set_nonblocking(true)?;
                Box::new(tokio::net::UnixStream::from_std(stream)?)
            }
        })
    }

    /// Sets the longest time of a read and of a write. Above zero.
    ///
    /// # Errors
    /// The system refuses it.
    pub fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        match self {
            Self::Serial(port) => Ok(port.set_timeout(timeout)?),
            Self::Tcp(stream) => {
                stream.set_read_timeout(Some(timeout)).and_then(|()| stream.set_write_timeout(Some(timeout)))
            }
            Self::Unix(stream) => {
                stream.set_read_timeout(Some(timeout)).and_then(|()| stream.set_write_timeout(Some(timeout)))
            }
        }
    }
}

/// A read of no bytes means that the other side has closed the connection, which is an error.
impl Read for Link {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = match self {
            Self::Serial(port) => port.read(buffer),
            Self::Tcp(stream) => stream.read(buffer),
            Self::Unix(stream) => stream.read(buffer),
        };
        match read {
            Ok(0) if !buffer.is_empty() => Err(closed()),
            other => other,
        }
    }
}

impl Write for Link {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Serial(port) => port.write(bytes),
            Self::Tcp(stream) => stream.write(bytes),
            Self::Unix(stream) => stream.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Serial(port) => port.flush(),
            Self::Tcp(stream) => stream.flush(),
            Self::Unix(stream) => stream.flush(),
        }
    }
}

/// The error of a connection that the other side has closed.
pub fn closed() -> io::Error {
    io::Error::new(io::ErrorKind::UnexpectedEof, "the other side closed the connection")
}
