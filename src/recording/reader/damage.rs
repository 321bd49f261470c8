//! What is wrong with a file, and where.

use std::path::PathBuf;
use std::{fmt, io};

use crate::exit;

/// A place in a file that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Where it begins, bytes from the start of the file.
    pub at: u64,
    /// Up to where nothing is known, in bytes.
    pub bytes: u64,
    /// What is wrong.
    pub what: String,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "at byte {}, {} bytes: {}", self.at, self.bytes, self.what)
    }
}

/// A file that is no recording at all.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The system says no.
    #[error("cannot read {}: {why}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        why: io::Error,
    },
    /// A pipe or a device: it has no length, and may never end.
    #[error("{} is {what}: a recording is a file", path.display())]
    NoFile {
        /// Its name.
        path: PathBuf,
        /// What it is.
        what: &'static str,
    },
    /// It is something else.
    #[error("{} is not an MCAP file", .0.display())]
    NotMcap(PathBuf),
}

impl ReadError {
    /// The exit code that tells its kind.
    pub fn code(&self) -> u8 {
        match self {
            Self::Io { .. } => exit::IO,
            Self::NoFile { .. } | Self::NotMcap(_) => exit::DATA,
        }
    }
}
