//! The lock state, as sent in frames.

/// State of the centering loop; the numbers are those of the pose frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum LockState {
    /// The loop is switched off.
    #[default]
    Off = 0,
    /// The operator moves the laser.
    Manual = 1,
    /// The loop searches for light.
    Searching = 2,
    /// The loop regulates or approaches the apex; the offset has not yet been within limits for the
    /// confirmation time.
    Acquiring = 3,
    /// The offset, its rms and the light are within limits, and the actuator is not at a limit.
    Locked = 4,
    /// The actuator is at a limit.
    Railed = 5,
    /// Light, samples or stage have failed for longer than the lost time of the loop.
    Lost = 6,
    /// The actuator holds: light, samples or stage have failed for less than that, or all searches have
    /// failed.
    Held = 7,
}

impl LockState {
    /// Every state, in the order of the numbers.
    pub const ALL: [LockState; 8] = [
        LockState::Off,
        LockState::Manual,
        LockState::Searching,
        LockState::Acquiring,
        LockState::Locked,
        LockState::Railed,
        LockState::Lost,
        LockState::Held,
    ];

    /// The state to report in a frame without samples or without light. The loop may have reported another
    /// state just before, or may report it just after.
    #[must_use]
    pub fn without_observation(self) -> LockState {
        match self {
            LockState::Acquiring | LockState::Locked | LockState::Railed => LockState::Held,
            other => other,
        }
    }

    /// Name of the state: "off", "locked".
    pub fn name(self) -> &'static str {
        match self {
            LockState::Off => "off",
            LockState::Manual => "manual",
            LockState::Searching => "searching",
            LockState::Acquiring => "acquiring",
            LockState::Locked => "locked",
            LockState::Railed => "railed",
            LockState::Lost => "lost",
            LockState::Held => "held",
        }
    }
}
