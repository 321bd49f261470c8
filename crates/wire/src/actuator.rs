//! Commands to the two steering outputs of a board, and its acknowledgements.

/// What the board does on its own when the lease of a steering command expires.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LeaseAction {
    /// The outputs stay where they are.
    #[default]
    Hold,
    /// The outputs move to their parking position.
    Park,
}

/// A target for the steering outputs, in output codes. The lease limits how long the outputs follow a daemon
/// that has stopped: without a newer command in time, the board acts on its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputCommand {
    /// Number of the command; the acknowledgement repeats it.
    pub id: u32,
    /// Signed codes of the two outputs.
    pub codes: [i32; 2],
    /// Validity of the command, milliseconds.
    pub lease_ms: u16,
    /// The action when the lease expires.
    pub on_expiry: LeaseAction,
}

/// The answer to an [`OutputCommand`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ack {
    /// Number of the command.
    pub id: u32,
    /// Whether the command was accepted. A board rejects codes outside its range.
    pub accepted: bool,
}
