//! The status bits of a pose frame.

use core::ops::{BitOr, BitOrAssign};

/// A set of status bits, numbered as in the pose frame (`docs/stream.md`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status(pub u32);

macro_rules! bits {
    ($($(#[doc = $doc:literal])* $name:ident = $bit:literal),* $(,)?) => {
        impl Status {
            $($(#[doc = $doc])* pub const $name: Status = Status(1 << $bit);)*

            /// Every bit with its name, in order.
            pub const NAMES: &'static [(Status, &'static str)] = &[$((Status::$name, stringify!($name))),*];

            /// The meaning of each bit, in the order of [`Status::NAMES`]. The text starts with `Fatal:` or
            /// `Warning:` for such bits.
            pub const MEANINGS: &'static [&'static str] = &[$(concat!($($doc),*).trim_ascii()),*];
        }
    };
}

bits! {
    /// The pose in this frame can be used.
    POSE_VALID = 0,
    /// Fatal: too little light on PSD A.
    PSD_A_LOW = 1,
    /// Fatal: too little light on PSD B.
    PSD_B_LOW = 2,
    /// Fatal: too little light on PSD C.
    PSD_C_LOW = 3,
    /// Fatal: a channel of PSD A is at its rail.
    PSD_A_CLIPPED = 4,
    /// Fatal: a channel of PSD B is at its rail.
    PSD_B_CLIPPED = 5,
    /// Fatal: a channel of PSD C is at its rail.
    PSD_C_CLIPPED = 6,
    /// Warning: the spot on PSD A is near the edge of the detector.
    PSD_A_EDGE = 7,
    /// Warning: the spot on PSD B is near the edge of the detector.
    PSD_B_EDGE = 8,
    /// Warning: the spot on PSD C is near the edge of the detector.
    PSD_C_EDGE = 9,
    /// Warning: the three powers differ by more than the limit.
    UNBALANCED = 10,
    /// Warning: the centering loop is not locked.
    NOT_LOCKED = 11,
    /// Warning: the steering is at a limit.
    STEERING_RAILED = 12,
    /// Fatal: the solver found no pose for these signals.
    NOT_CONVERGED = 13,
    /// Fatal: a spot is off its PSD, or the pose is outside the sensor's range.
    OUT_OF_RANGE = 14,
    /// Warning: samples were lost just before this one.
    SAMPLE_GAP = 15,
    /// Fatal: no samples.
    SOURCE_DOWN = 16,
    /// Warning: the measurement time is not reliable.
    CLOCK_UNSYNCED = 17,
    /// Warning: no valid calibration record belongs to the configuration.
    UNCALIBRATED = 18,
    /// Warning: the steering readback contradicts the pose.
    INCONSISTENT = 19,
    /// The light is simulated, not measured.
    SIMULATED = 20,
    /// The samples come from a recording.
    REPLAYED = 21,
    /// The pose is the last valid one, sent to a client that asked for `held`.
    POSE_HELD = 22,
    /// The steering position is read back, not only commanded.
    STEERING_MEASURED = 23,
    /// Warning: the recorder lost data.
    RECORDING_FAULT = 24,
    /// Fatal: the laser power has stepped.
    POWER_STEP = 25,
    /// Fatal: a channel repeats the same code; it is not measured.
    CHANNEL_FROZEN = 26,
    /// Fatal: the power of a PSD is not known to a fifth of itself.
    POWER_NOISY = 27,
    /// Warning: a spot is where the correction table of its PSD has no measurements.
    OUT_OF_CALIBRATION = 28,
}

impl Status {
    /// Bits with which a frame has no pose.
    pub const FATAL: Status = Status(
        Status::PSD_A_LOW.0
            | Status::PSD_B_LOW.0
            | Status::PSD_C_LOW.0
            | Status::PSD_A_CLIPPED.0
            | Status::PSD_B_CLIPPED.0
            | Status::PSD_C_CLIPPED.0
            | Status::NOT_CONVERGED.0
            | Status::OUT_OF_RANGE.0
            | Status::SOURCE_DOWN.0
            | Status::POWER_STEP.0
            | Status::CHANNEL_FROZEN.0
            | Status::POWER_NOISY.0,
    );

    /// Bits with which a pose is not usable for control: it contradicts another signal, its stated
    /// uncertainty does not hold because a spot is outside the calibrated area, its time is unknown, it is an earlier
    /// one, or its light was not measured now. A caller may permit some of them ([`Status::usable`]).
    pub const UNUSABLE: Status = Status(
        Status::INCONSISTENT.0
            | Status::OUT_OF_CALIBRATION.0
            | Status::CLOCK_UNSYNCED.0
            | Status::POSE_HELD.0
            | Status::REPLAYED.0
            | Status::SIMULATED.0,
    );

    /// Whether a control may use the pose: `POSE_VALID` is set, and of [`Status::UNUSABLE`] at most the
    /// `permitted` bits. This is the one definition that readiness, alerts, client kits and the masks for PLCs
    /// follow. Whether the beam is on the apex (`NOT_LOCKED`) is a separate question, because a pose without
    /// lock is valid, with larger uncertainties.
    ///
    /// ```
    /// use trifacet_wire::Status;
    ///
    /// let frame = Status::POSE_VALID | Status::SIMULATED | Status::UNCALIBRATED;
    /// assert!(!frame.usable(Status::default()));
    /// assert!(frame.usable(Status::SIMULATED)); // to test with the digital twin
    /// ```
    pub fn usable(self, permitted: Status) -> bool {
        self.has(Status::POSE_VALID) && self.0 & Status::UNUSABLE.0 & !permitted.0 == 0
    }

    /// Whether all bits of `other` are set.
    pub fn has(self, other: Status) -> bool {
        self.0 & other.0 == other.0
    }

    /// Sets `bits` if `on`.
    pub fn set(&mut self, bits: Status, on: bool) {
        if on {
            *self |= bits;
        }
    }

    /// The names of the set bits, in order.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMES.iter().filter(move |(bit, _)| self.has(*bit)).map(|(_, name)| *name)
    }
}

impl BitOr for Status {
    type Output = Status;
    fn bitor(self, other: Status) -> Status {
        Status(self.0 | other.0)
    }
}

impl BitOrAssign for Status {
    fn bitor_assign(&mut self, other: Status) {
        self.0 |= other.0;
    }
}
