//! The lock state, as frames and people see it.

/// What the centering loop is doing; the numbers are those of the pose frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum LockState {
    /// The loop is switched off.
    #[default]
    Off = 0,
    /// A person moves the laser.
    Manual = 1,
    /// Looking for light.
    Searching = 2,
    /// Light is there; the offset is not yet within limits for long enough.
    Acquiring = 3,
    /// The offset, its rms and the light are within limits, and the actuator is off its rails.
    Locked = 4,
    /// The actuator stands at a limit.
    Railed = 5,
    /// No light for longer than the confirmation time.
    Lost = 6,
    /// The actuator holds: no light, or no trustworthy sample, for less than that.
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

    /// What may be claimed of this state on a frame without samples or without light. The loop may have
    /// said it a moment before, or after.
    #[must_use]
    pub fn without_observation(self) -> LockState {
        match self {
            LockState::Acquiring | LockState::Locked | LockState::Railed => LockState::Held,
            other => other,
        }
    }

    /// The state as a word: "off", "locked".
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
