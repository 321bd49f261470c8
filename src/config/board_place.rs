//! Where an acquisition board is: at a serial port, at an address of the network, or behind a Unix socket.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use super::{Destination, DestinationError};

/// Longest path of a Unix socket that the kernel accepts, bytes, without the terminating zero.
pub(super) const LONGEST_SOCKET: usize = 107;

/// What a Unix socket begins with in a text.
const UNIX: &str = "unix:";

/// Where a board is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BoardPlace {
    /// A serial port.
    Serial {
        /// Path of its device.
        port: PathBuf,
        /// Line rate, bits per second.
        baud: u32,
    },
    /// A host and a TCP port.
    Tcp(Destination),
    /// The path of a Unix socket.
    Unix(PathBuf),
}

impl BoardPlace {
    /// The line rate, bits per second, if the place has one.
    pub fn baud(&self) -> Option<u32> {
        match self {
            Self::Serial { baud, .. } => Some(*baud),
            Self::Tcp(_) | Self::Unix(_) => None,
        }
    }

    /// The place that a text on a command line names: `unix:PATH`, `HOST:PORT`, or the path of a serial port, which is
    /// used with this line rate.
    ///
    /// # Errors
    /// The text is none of these.
    pub fn parse(text: &str, baud: u32) -> Result<Self, DestinationError> {
        if let Some(path) = text.strip_prefix(UNIX) {
            return Ok(Self::Unix(path.into()));
        }
        // An IPv6 address with a zone contains no slash either.
        if text.contains(':') && !text.contains('/') {
            return Destination::from_str(text).map(Self::Tcp);
        }
        Ok(Self::Serial { port: text.into(), baud })
    }
}

impl fmt::Display for BoardPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial { port, .. } => write!(f, "{}", port.display()),
            Self::Tcp(address) => address.fmt(f),
            Self::Unix(path) => write!(f, "{UNIX}{}", path.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_names_a_place_of_each_kind() {
        for text in ["/dev/ttyACM0", "daq.lan:7365", "[::1]:7365", "unix:/run/board.sock"] {
            assert_eq!(BoardPlace::parse(text, 9600).unwrap().to_string(), text);
        }
        // The names in /dev/serial/by-path contain colons.
        let by_path = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0";
        let serial = BoardPlace::Serial { port: by_path.into(), baud: 9600 };
        assert_eq!(BoardPlace::parse(by_path, 9600), Ok(serial));
        assert_eq!(BoardPlace::parse("daq.lan:70000", 9600), Err(DestinationError));
    }
}
