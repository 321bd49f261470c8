//! The exit codes of `trifacet`, those of `sysexits.h`, so that a supervisor can tell a mistake in a
//! file from a device that is busy.

use std::fmt::Display;
use std::io;

/// A replay gave other poses than those that were recorded.
pub const DIFFERENT: u8 = 1;
/// The command line is wrong.
pub const USAGE: u8 = 64;
/// Some of the input could not be worked on, rows or parts of a recording; the rest was. Or the input is something else.
pub const DATA: u8 = 65;
/// The other side is not there: nothing listens, or no frame came.
pub const UNAVAILABLE: u8 = 69;
/// A task of the daemon ended by itself: a defect.
pub const SOFTWARE: u8 = 70;
/// A file or a socket could not be read or written.
pub const IO: u8 = 74;
/// Something is in use by another process: a port of either kind. Trying later may work.
pub const IN_USE: u8 = 75;
/// The configuration is wrong.
pub const CONFIG: u8 = 78;
/// Interrupted by a person: 128 and the number of SIGINT, as shells have it.
pub const INTERRUPTED: u8 = 130;

/// An error with the exit code that tells its kind.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct Failure {
    /// One of the codes of this module.
    pub code: u8,
    /// What happened, where, and what is allowed.
    pub message: String,
}

impl Failure {
    /// A failure of this kind with this message.
    pub fn new(code: u8, message: impl Into<String>) -> Self {
        Self { code, message: message.into() }
    }

    /// A port could not be opened: [`IN_USE`] if another process has it, else [`IO`]. `what` was to be done.
    pub fn port(what: impl Display, e: &io::Error) -> Self {
        let (code, why) = match e.kind() {
            io::ErrorKind::AddrInUse => (IN_USE, "another process has the port".to_owned()),
            _ => (IO, e.to_string()),
        };
        Self::new(code, format!("cannot {what}: {why}"))
    }
}
