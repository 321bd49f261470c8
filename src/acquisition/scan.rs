//! What travels: raw scans from a converter, samples from the channel map.

use serde::{Deserialize, Serialize};

use crate::clock::Mono;

/// The most channels a scan can carry.
pub const MAX_CHANNELS: usize = 16;

/// What a channel of the converter measures. The numbers are those of the board protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// First coordinate of PSD 0 (A), 1 (B) or 2 (C): a difference or a normalised position.
    U(u8),
    /// Second coordinate of a PSD.
    V(u8),
    /// Sum signal of a PSD: its power.
    Sum(u8),
    /// Readback of the steering position, axis 0 (x) or 1 (y).
    Steering(u8),
    /// Temperature, or anything else that the board measures besides.
    Auxiliary,
}

impl Role {
    /// Its number.
    pub fn number(self) -> u8 {
        match self {
            Role::Auxiliary => 0x00,
            Role::U(psd) => 0x10 + psd,
            Role::V(psd) => 0x20 + psd,
            Role::Sum(psd) => 0x30 + psd,
            Role::Steering(axis) => 0x40 + axis,
        }
    }

    /// The role of a number; a number that is not known is a channel that is not needed.
    pub fn of(number: u8) -> Self {
        match (number >> 4, number & 0x0f) {
            (1, psd @ 0..=2) => Role::U(psd),
            (2, psd @ 0..=2) => Role::V(psd),
            (3, psd @ 0..=2) => Role::Sum(psd),
            (4, axis @ 0..=1) => Role::Steering(axis),
            _ => Role::Auxiliary,
        }
    }
}

/// The nine signals of the sensor in their canonical order: u, v, sum of A, then of B, then of C.
pub const SIGNALS: [Role; 9] = [
    Role::U(0),
    Role::V(0),
    Role::Sum(0),
    Role::U(1),
    Role::V(1),
    Role::Sum(1),
    Role::U(2),
    Role::V(2),
    Role::Sum(2),
];

/// How codes relate to volts: two's complement, full scale at `2^(bits-1)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Converter {
    /// Resolution, 8 to 24 bits, sign included.
    pub bits: u8,
    /// Volts at full scale: the range is from `-range_v` to just below `+range_v`.
    pub range_v: f64,
}

impl Converter {
    /// The code of full scale, `2^(bits-1)`. The largest code is one less.
    pub fn full_scale(&self) -> i32 {
        1 << (self.bits - 1)
    }

    /// Volts of one code step.
    pub fn step_v(&self) -> f64 {
        self.range_v / f64::from(self.full_scale())
    }

    /// The code nearest to a voltage, clipped at the rails as a real converter clips.
    pub fn code(&self, volts: f64) -> i32 {
        let full = f64::from(self.full_scale());
        (volts / self.step_v()).round().clamp(-full, full - 1.0) as i32
    }
}

/// What a source says of itself before its first scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Identity {
    /// Name, firmware and serial number, as a person would want to read them.
    pub name: String,
    /// Scans per second.
    pub rate_hz: f64,
    /// The converter behind every channel.
    pub converter: Converter,
    /// What each channel measures, in the order of the codes; 9 to 16 of them.
    pub roles: Vec<Role>,
    /// When each channel is sampled, after the time of the scan; nanoseconds, same order.
    pub skew_ns: Vec<u32>,
    /// Resolution of the steering outputs in bits, sign included.
    pub output_bits: u8,
    /// Whether the light is computed rather than measured (SIMULATED in the frames).
    pub simulated: bool,
}

/// One scan of the converter: raw codes with their time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    /// Counts every sample of the converter, also those that were lost; never goes back.
    pub index: u64,
    /// When the scan was taken (not when it arrived).
    pub time: Mono,
    /// One standard deviation of `time` in nanoseconds, if known.
    pub time_sigma_ns: Option<f64>,
    /// Samples lost between this scan and the one before.
    pub lost: u32,
    /// The codes; only the first `Identity::roles.len()` have a meaning.
    pub codes: [i32; MAX_CHANNELS],
    /// The stage stands at a limit of its own, as the board reports it.
    pub output_railed: bool,
}

/// What is known of one PSD in one sample. `Good` has a position; nothing else has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum PsdState {
    /// Light within limits.
    #[default]
    Good,
    /// The sum signal is below the threshold: no position exists.
    Low,
    /// A channel stands at its rail.
    Clipped,
}

/// The nine signals in physical units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// As in [`Scan::index`].
    pub index: u64,
    /// As in [`Scan::time`].
    pub time: Mono,
    /// As in [`Scan::time_sigma_ns`].
    pub time_sigma_ns: Option<f64>,
    /// As in [`Scan::lost`].
    pub lost: u32,
    /// u, v of A, B, C in metres; NaN where the PSD's state is not `Good`.
    pub spots: [f64; 6],
    /// Power on A, B, C in watts.
    pub powers: [f64; 3],
    /// State of each PSD.
    pub psds: [PsdState; 3],
    /// Steering position read back in the same scan, metres.
    pub steering: Option<[f64; 2]>,
    /// As in [`Scan::output_railed`].
    pub output_railed: bool,
}

impl Sample {
    /// Whether this one comes after the one with that index, all that is known as lost counted.
    pub fn follows(&self, index: u64) -> bool {
        let between = self.index.checked_sub(index).and_then(|steps| steps.checked_sub(1));
        between.is_some_and(|between| u32::try_from(between).unwrap_or(u32::MAX) == self.lost)
    }
}
