//! The trait of a source of scans: the twin, or a board.

use std::future::Future;

use trifacet_core::signals::{Identity, Scan};
use trifacet_core::time::Mono;
use trifacet_wire::actuator::{Ack, OutputCommand};

use super::board::Foreign;

/// Reasons why there are no scans.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SourceError {
    /// The link cannot be opened.
    #[error("cannot open {port}: {reason}")]
    Open {
        /// The port, the address or the socket.
        port: String,
        /// What is wrong.
        reason: String,
    },
    /// The connection is lost: unplugged, or closed by the other side.
    #[error("{port} was disconnected: {reason}")]
    Unplugged {
        /// The port, the address or the socket.
        port: String,
        /// Error message of the system.
        reason: String,
    },
    /// The board serves another host, and has closed the connection.
    #[error("{port} is in use by {host}: a board serves one host at a time")]
    InUse {
        /// The address or the socket.
        port: String,
        /// The other host, as the board names it.
        host: String,
    },
    /// The board does not answer a request in time.
    #[error("no answer to {step} within {timeout_ms} ms; {line}")]
    Timeout {
        /// The request: "identify", "start".
        step: &'static str,
        /// The time limit, milliseconds.
        timeout_ms: u32,
        /// What arrives instead.
        line: Foreign,
    },
    /// The source answers, but cannot be used.
    #[error("{what} cannot be used: {reason}")]
    Unfit {
        /// The source.
        what: String,
        /// What does not fit.
        reason: String,
    },
    /// No more scans arrive.
    #[error("no scan for {silence_ms} ms")]
    Stalled {
        /// Time since the last scan, milliseconds.
        silence_ms: u32,
    },
}

/// Events of a source.
#[derive(Clone, Debug, PartialEq)]
pub enum SourceEvent {
    /// The source is ready; scans follow.
    Up(Identity),
    /// A scan.
    Scan(Scan),
    /// Acknowledgement of a steering command.
    Ack(Ack),
    /// There are no scans, for this reason. The source keeps trying on its own; `Up` or the next `Scan` ends
    /// this state.
    Down(SourceError),
}

/// A converter that delivers scans and takes steering commands.
pub trait Source {
    /// The next event. Cancel-safe: dropping the future loses nothing.
    fn next(&mut self) -> impl Future<Output = SourceEvent>;

    /// Takes the newest steering command; an older one that has not been sent yet is dropped. Never waits.
    /// `now` is the present time.
    fn steer(&mut self, command: OutputCommand, now: Mono);

    /// Closes the connection: sends the last command, and requests the board to stop. Takes a bounded time.
    fn close(self) -> impl Future<Output = ()>;
}
