//! The exit codes of `trifacet`, those of `sysexits.h`, so that a supervisor can distinguish a wrong
//! configuration from a busy device.

use std::fmt::Display;
use std::io;

/// The poses of a replay differ from the recorded ones.
pub const DIFFERENT: u8 = 1;
/// The command line is wrong.
pub const USAGE: u8 = 64;
/// Some of the input could not be processed (rows of a table, parts of a recording), or the input is of
/// another type.
pub const DATA: u8 = 65;
/// Nothing to communicate with: no program listens, or no frame arrived.
pub const UNAVAILABLE: u8 = 69;
/// A task of the daemon ended or stalled: a defect.
pub const SOFTWARE: u8 = 70;
/// A file or a socket could not be read or written.
pub const IO: u8 = 74;
/// Another process uses a serial or network port. A later attempt may succeed.
pub const IN_USE: u8 = 75;
/// The configuration is wrong.
pub const CONFIG: u8 = 78;
/// Interrupted by the operator: 128 plus the number of SIGINT, as in shells.
pub const INTERRUPTED: u8 = 130;

/// An error with its exit code.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct Failure {
    /// One of the codes of this module.
    pub code: u8,
    /// The error, its place, and the allowed values.
    pub message: String,
}

impl Failure {
    /// A failure of this kind with this message.
    pub fn new(code: u8, message: impl Into<String>) -> Self {
        Self { code, message: message.into() }
    }

    /// A port could not be opened: [`IN_USE`] if another process uses it, otherwise [`IO`]. `what` is the
    /// attempted action.
    pub fn port(what: impl Display, e: &io::Error) -> Self {
        let (code, why) = match e.kind() {
            io::ErrorKind::AddrInUse => (IN_USE, "another process has the port".to_owned()),
            _ => (IO, e.to_string()),
        };
        Self::new(code, format!("cannot {what}: {why}"))
    }
}
