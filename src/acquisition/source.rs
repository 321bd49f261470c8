//! The trait behind which a converter stands, be it simulated or at the end of a cable.

use std::future::Future;

use trifacet_core::signals::{Identity, Scan};
use trifacet_core::time::Mono;
use trifacet_wire::actuator::{Ack, OutputCommand};

/// Why no scans come.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SourceError {
    /// The port cannot be opened.
    #[error("cannot open {port}: {reason}")]
    Open {
        /// Path of the port.
        port: String,
        /// What the system says.
        reason: String,
    },
    /// The link broke: unplugged, or the other side is gone.
    #[error("{port} is gone: {reason}")]
    Unplugged {
        /// Path of the port.
        port: String,
        /// What the system says.
        reason: String,
    },
    /// The board is there and does not answer within the time for this step.
    #[error("no answer to {step} within {timeout_ms} ms")]
    Timeout {
        /// What was asked: "identify", "start".
        step: &'static str,
        /// The limit that ran out.
        timeout_ms: u32,
    },
    /// The board speaks, and cannot be used.
    #[error("the board cannot be used: {0}")]
    Unfit(String),
    /// Scans stopped coming.
    #[error("no scan for {silence_ms} ms")]
    Stalled {
        /// How long nothing came.
        silence_ms: u32,
    },
}

/// What a source reports.
#[derive(Clone, Debug, PartialEq)]
pub enum SourceEvent {
    /// The source is ready; scans follow.
    Up(Identity),
    /// A scan.
    Scan(Scan),
    /// An answer to a steering command.
    Ack(Ack),
    /// Scans have stopped, for this reason. The source keeps trying by itself; `Up` or the next
    /// `Scan` ends it.
    Down(SourceError),
}

/// A converter that delivers scans and takes steering commands.
pub trait Source {
    /// The next thing to know. Cancel-safe: dropping the future loses nothing.
    fn next(&mut self) -> impl Future<Output = SourceEvent>;

    /// Takes the newest steering command; an older one not yet sent is dropped.
    /// Never waits. `now` is the present moment.
    fn steer(&mut self, command: OutputCommand, now: Mono);

    /// Ends the conversation: what was commanded last still goes out, and the board is asked to stop.
    /// Takes a bounded time.
    fn close(self) -> impl Future<Output = ()>;
}
