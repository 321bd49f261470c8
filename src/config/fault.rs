//! `[[twin.fault]]`: simulated faults of the twin and their times.

use serde::{Deserialize, Serialize};

use super::check::{Checker, Report};

/// Kind of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum FaultKind {
    /// No light at all.
    BeamBlocked,
    /// One PSD (0 to 2 for A to C) sees no light.
    PsdDark {
        /// Index of the PSD.
        psd: u8,
    },
    /// One channel (0 to 8) reads the limit of its range.
    Clipped {
        /// Index of the channel.
        channel: u8,
    },
    /// One channel (0 to 8) repeats its last code.
    Frozen {
        /// Index of the channel.
        channel: u8,
    },
    /// The readback of the stage repeats its last codes.
    ReadbackFrozen,
    /// The clock of the board runs at another rate; with factor 0 it stands still. Only an emulated board has a
    /// clock of its own.
    ClockRate {
        /// The factor.
        factor: f64,
    },
    /// A fraction of the scans is not sent by the board.
    Dropped {
        /// Fraction, 0 to 1.
        fraction: f64,
    },
    /// A fraction of the scans is damaged in transit.
    Corrupted {
        /// Fraction, 0 to 1.
        fraction: f64,
    },
    /// The board stops sending.
    Stalled,
    /// The board sends in bursts, as some USB hubs do. Only an emulated board does this.
    Bursts {
        /// Interval between two bursts, milliseconds.
        interval_ms: f64,
    },
    /// The board executes commands, but acknowledges none.
    MuteAcks,
    /// The board executes commands, but acknowledges other ids.
    WrongAcks,
    /// The stage ignores commands.
    SteeringStuck,
    /// The power of the laser is multiplied by a factor.
    LaserPower {
        /// The factor.
        factor: f64,
    },
    /// The power of the laser changes as a sine.
    Flicker {
        /// Amplitude, as a fraction of the power, 0 to 1.
        fraction: f64,
        /// Frequency, hertz.
        frequency_hz: f64,
    },
    /// Other light than that of the laser falls on all PSDs.
    AmbientLight {
        /// Its power on each PSD, as a fraction of a third of the power of the laser, 0 to 1.
        fraction: f64,
    },
    /// The noise of spots and powers is multiplied by a factor.
    NoiseBurst {
        /// The factor.
        factor: f64,
    },
    /// The laser is displaced in its mount: the beam moves, but the readback of the stage does not change.
    LaserBump {
        /// Displacement in x and y, micrometres.
        shift_um: [f64; 2],
    },
}

/// An entry of `[[twin.fault]]`: a fault that starts at `at_s` and lasts `for_s` seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "FaultKeys")]
pub struct Fault {
    /// Start time, seconds.
    pub at_s: f64,
    /// Duration, seconds. `None`: permanent.
    pub for_s: Option<f64>,
    /// Kind of the fault.
    #[serde(flatten)]
    pub kind: FaultKind,
}

/// The keys as in the file. The kind determines which of the last seven are allowed.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FaultKeys {
    at_s: f64,
    for_s: Option<f64>,
    kind: KindName,
    psd: Option<u8>,
    channel: Option<u8>,
    fraction: Option<f64>,
    frequency_hz: Option<f64>,
    factor: Option<f64>,
    interval_ms: Option<f64>,
    shift_um: Option<[f64; 2]>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum KindName {
    BeamBlocked,
    PsdDark,
    Clipped,
    Frozen,
    ReadbackFrozen,
    ClockRate,
    Dropped,
    Corrupted,
    Stalled,
    Bursts,
    MuteAcks,
    WrongAcks,
    SteeringStuck,
    LaserPower,
    Flicker,
    AmbientLight,
    NoiseBurst,
    LaserBump,
}

/// The keys of a fault do not suit its kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultKeyError {
    /// A required key is absent.
    #[error("this kind of fault needs the key `{key}`")]
    Missing {
        /// Name of the key.
        key: &'static str,
    },
    /// The key belongs to another kind.
    #[error("`{key}` does not belong to this kind of fault")]
    Stray {
        /// Name of the key.
        key: &'static str,
    },
}

impl TryFrom<FaultKeys> for Fault {
    type Error = FaultKeyError;

    fn try_from(mut keys: FaultKeys) -> Result<Self, FaultKeyError> {
        let kind = match keys.kind {
            KindName::BeamBlocked => FaultKind::BeamBlocked,
            KindName::PsdDark => FaultKind::PsdDark { psd: needed(keys.psd.take(), "psd")? },
            KindName::Clipped => FaultKind::Clipped { channel: needed(keys.channel.take(), "channel")? },
            KindName::Frozen => FaultKind::Frozen { channel: needed(keys.channel.take(), "channel")? },
            KindName::ReadbackFrozen => FaultKind::ReadbackFrozen,
            KindName::ClockRate => FaultKind::ClockRate { factor: needed(keys.factor.take(), "factor")? },
            KindName::Dropped => FaultKind::Dropped { fraction: needed(keys.fraction.take(), "fraction")? },
            KindName::Corrupted => {
                FaultKind::Corrupted { fraction: needed(keys.fraction.take(), "fraction")? }
            }
            KindName::Stalled => FaultKind::Stalled,
            KindName::Bursts => {
                FaultKind::Bursts { interval_ms: needed(keys.interval_ms.take(), "interval_ms")? }
            }
            KindName::MuteAcks => FaultKind::MuteAcks,
            KindName::WrongAcks => FaultKind::WrongAcks,
            KindName::SteeringStuck => FaultKind::SteeringStuck,
            KindName::LaserPower => FaultKind::LaserPower { factor: needed(keys.factor.take(), "factor")? },
            KindName::Flicker => FaultKind::Flicker {
                fraction: needed(keys.fraction.take(), "fraction")?,
                frequency_hz: needed(keys.frequency_hz.take(), "frequency_hz")?,
            },
            KindName::AmbientLight => {
                FaultKind::AmbientLight { fraction: needed(keys.fraction.take(), "fraction")? }
            }
            KindName::NoiseBurst => FaultKind::NoiseBurst { factor: needed(keys.factor.take(), "factor")? },
            KindName::LaserBump => {
                FaultKind::LaserBump { shift_um: needed(keys.shift_um.take(), "shift_um")? }
            }
        };
        let stray = [
            ("psd", keys.psd.is_some()),
            ("channel", keys.channel.is_some()),
            ("fraction", keys.fraction.is_some()),
            ("frequency_hz", keys.frequency_hz.is_some()),
            ("factor", keys.factor.is_some()),
            ("interval_ms", keys.interval_ms.is_some()),
            ("shift_um", keys.shift_um.is_some()),
        ];
        match stray.into_iter().find(|(_, is_there)| *is_there) {
            Some((key, _)) => Err(FaultKeyError::Stray { key }),
            None => Ok(Self { at_s: keys.at_s, for_s: keys.for_s, kind }),
        }
    }
}

fn needed<T>(value: Option<T>, key: &'static str) -> Result<T, FaultKeyError> {
    value.ok_or(FaultKeyError::Missing { key })
}

impl Fault {
    /// Whether all its values are in range.
    pub fn is_possible(&self) -> bool {
        let mut report = Report::default();
        self.check(Checker::root(&mut report));
        report.findings.is_empty()
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("at_s", self.at_s, 0.0..=1e6);
        at.optional("for_s", self.for_s, 0.0..=1e6);
        match self.kind {
            FaultKind::PsdDark { psd } => at.number("psd", psd, 0.0..=2.0),
            FaultKind::Clipped { channel } | FaultKind::Frozen { channel } => {
                at.number("channel", channel, 0.0..=8.0);
            }
            FaultKind::Dropped { fraction }
            | FaultKind::Corrupted { fraction }
            | FaultKind::AmbientLight { fraction } => {
                at.number("fraction", fraction, 0.0..=1.0);
            }
            FaultKind::LaserPower { factor }
            | FaultKind::NoiseBurst { factor }
            | FaultKind::ClockRate { factor } => {
                at.number("factor", factor, 0.0..=1000.0);
            }
            FaultKind::Flicker { fraction, frequency_hz } => {
                at.number("fraction", fraction, 0.0..=1.0);
                at.number("frequency_hz", frequency_hz, 0.0..=100_000.0);
            }
            FaultKind::Bursts { interval_ms } => at.number("interval_ms", interval_ms, 1.0..=10_000.0),
            FaultKind::LaserBump { shift_um } => at.numbers("shift_um", &shift_um, -10_000.0..=10_000.0),
            FaultKind::BeamBlocked
            | FaultKind::ReadbackFrozen
            | FaultKind::Stalled
            | FaultKind::MuteAcks
            | FaultKind::WrongAcks
            | FaultKind::SteeringStuck => {}
        }
    }
}
