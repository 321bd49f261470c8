//! The state of an emulated board, for its operator.

use serde::Serialize;

/// The last cause of a motion of the steering outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Steering {
    /// None since power-up: the outputs are at zero.
    #[default]
    Idle,
    /// A command whose lease is valid.
    Commanded,
    /// An expired lease; the outputs stayed.
    Held,
    /// An expired lease; the outputs moved to their parking position.
    Parked,
}

/// State of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BoardState {
    /// Seconds since power-up.
    pub time_s: f64,
    /// Whether a host has started the board.
    pub started: bool,
    /// Pose of the mirror in the last scan: tx, ty, tz (m), roll, pitch, yaw (rad).
    pub mirror: [f64; 6],
    /// Codes of the steering outputs.
    pub output_codes: [i32; 2],
    /// Position of the steering outputs in micrometres.
    pub output_um: [f64; 2],
    /// The last cause of their motion.
    pub steering: Steering,
    /// Whether the lease of the last command has expired.
    pub lease_expired: bool,
    /// Scans given to the port, including those damaged by a fault.
    pub scans_sent: u64,
    /// Scans not sent because of a fault or a full buffer.
    pub scans_unsent: u64,
    /// Accepted commands.
    pub commands_taken: u64,
    /// Rejected commands.
    pub commands_refused: u64,
}
