//! Damage in a file, and its position.

use std::path::PathBuf;
use std::{fmt, io};

use crate::exit;

/// A part of a file that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Start, in bytes from the beginning of the file.
    pub at: u64,
    /// Length of the unreadable part in bytes.
    pub bytes: u64,
    /// Description.
    pub what: String,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "at byte {}, {} bytes: {}", self.at, self.bytes, self.what)
    }
}

/// Why a file cannot be read as a recording.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The system reports an error.
    #[error("cannot read {}: {why}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error.
        why: io::Error,
    },
    /// A pipe, a device or a folder. Pipes and devices have no length and may never end.
    #[error("{} is {what}: a recording is a file", path.display())]
    NoFile {
        /// Its path.
        path: PathBuf,
        /// Its kind.
        what: &'static str,
    },
    /// A file of another format.
    #[error("{} is not an MCAP file", .0.display())]
    NotMcap(PathBuf),
    /// A file without a single byte.
    #[error("{} is not an MCAP file: it is empty, and contains nothing to restore", .0.display())]
    Empty(PathBuf),
}

impl ReadError {
    /// The exit code for this kind of error.
    pub fn code(&self) -> u8 {
        match self {
            Self::Io { .. } => exit::IO,
            Self::NoFile { .. } | Self::NotMcap(_) | Self::Empty(_) => exit::DATA,
        }
    }
}
