//! Signals between the parts of the daemon: raw scans from a converter, samples from the channel map.

use serde::{Deserialize, Serialize};
use trifacet_wire::channel::{Converter, MAX_CHANNELS, Role, SIGNALS};

use crate::time::Mono;

/// Description of a source, reported before its first scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Identity {
    /// Name, firmware and serial number, in readable form.
    pub name: String,
    /// Scans per second.
    pub rate_hz: f64,
    /// The converter of all channels.
    pub converter: Converter,
    /// What each channel measures, in the order of the codes; 9 to 16 of them.
    pub roles: Vec<Role>,
    /// Sampling time of each channel after the time of the scan; nanoseconds, same order.
    pub skew_ns: Vec<u32>,
    /// Resolution of the steering outputs in bits, sign included.
    pub output_bits: u8,
    /// Whether the light is simulated, not measured (SIMULATED in the frames).
    pub simulated: bool,
}

impl Identity {
    /// A board with the nine signals in their usual order, 16 bits, +-10 V, 1 kHz: for examples and tests.
    pub fn example() -> Self {
        Self {
            name: "example board".into(),
            rate_hz: 1000.0,
            converter: Converter { bits: 16, range_v: 10.0 },
            roles: SIGNALS.to_vec(),
            skew_ns: vec![0; SIGNALS.len()],
            output_bits: 16,
            simulated: false,
        }
    }

    /// Index of the channel that measures this.
    pub fn place(&self, role: Role) -> Option<usize> {
        self.roles.iter().position(|other| *other == role)
    }

    /// Sampling time of each channel after the time of the scan, as a part of the sampling period.
    pub fn skews(&self) -> impl Iterator<Item = f64> {
        self.skew_ns.iter().map(|ns| f64::from(*ns) * 1e-9 * self.rate_hz)
    }
}

/// One scan of the converter: raw codes with their time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    /// Counts every sample of the converter, lost ones included; never decreases.
    pub index: u64,
    /// When the scan was taken (not when it arrived).
    pub time: Mono,
    /// Standard uncertainty of `time` in nanoseconds, if known.
    pub time_sigma_ns: Option<f64>,
    /// Samples lost between the previous scan and this one.
    pub lost: u32,
    /// The codes; only the first `Identity::roles.len()` have a meaning.
    pub codes: [i32; MAX_CHANNELS],
    /// The stage is at a limit of its own, as the board reports it.
    pub output_railed: bool,
    /// Id of the last command that the outputs had taken over when the scan was taken, if the source states it. Not
    /// recorded.
    #[serde(skip)]
    pub applied: Option<u32>,
}

/// State of one PSD in one sample. Only `Good` has a position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum PsdState {
    /// Light within limits.
    #[default]
    Good,
    /// The sum signal is below the threshold: no position exists.
    Low,
    /// A channel is at the rail of the converter.
    Clipped,
    /// A channel repeats the same code although its signal has noise: it is not measured.
    Frozen,
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
    /// As in [`Scan::applied`].
    #[serde(skip)]
    pub applied: Option<u32>,
    /// A spot is outside the area that the correction table of its PSD covers. Not recorded: the channel map finds it
    /// again.
    #[serde(skip)]
    pub uncovered: bool,
}

impl Sample {
    /// Whether this sample directly follows the one with that index, known losses included.
    pub fn follows(&self, index: u64) -> bool {
        let between = self.index.checked_sub(index).and_then(|steps| steps.checked_sub(1));
        between.is_some_and(|between| u32::try_from(between).unwrap_or(u32::MAX) == self.lost)
    }
}
