//! Commands to the two steering outputs of a board, and its answers.

/// What the board does by itself when the lease of a steering command expires.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LeaseAction {
    /// The outputs stay where they are.
    #[default]
    Hold,
    /// The outputs go to their parking position.
    Park,
}

/// A target for the steering outputs, in output codes. The lease limits how long a dead daemon can go on
/// steering: without a newer command in time the board acts by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputCommand {
    /// Number of the command; the acknowledgement repeats it.
    pub id: u32,
    /// Signed codes of the two outputs.
    pub codes: [i32; 2],
    /// How long the command is valid, milliseconds.
    pub lease_ms: u16,
    /// What the board does after that.
    pub on_expiry: LeaseAction,
}

/// The answer to an [`OutputCommand`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ack {
    /// Number of the command.
    pub id: u32,
    /// Whether the command was accepted. A board refuses what is outside its range.
    pub accepted: bool,
}
