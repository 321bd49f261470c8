//! `[acquisition]`: the source of the samples.

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use trifacet_core::pipeline::SilenceTimes;

use super::LabjackConfig;
use super::check::Checker;

/// Kind of source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SourceKind {
    /// The digital twin.
    Twin,
    /// An acquisition board on a serial port.
    Serial,
    /// A LabJack T7.
    Labjack,
    /// A recording.
    Replay,
}

/// Settings of `[acquisition]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AcquisitionConfig {
    /// Source of the samples.
    pub source: SourceKind,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Time without samples after which the source counts as down, milliseconds.
    pub silence_ms: f64,
    /// Settings of the serial board.
    pub serial: SerialConfig,
    /// Settings of the LabJack T7.
    pub labjack: LabjackConfig,
}

/// Settings of `[acquisition.serial]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SerialConfig {
    /// Device path of the port.
    pub port: PathBuf,
    /// Line rate, bits per second. A byte takes ten bits.
    pub baud: u32,
    /// Constant delay from the tick of a scan to the arrival of its last byte, microseconds. It is subtracted
    /// from arrival times.
    pub latency_us: f64,
}

impl Default for AcquisitionConfig {
    fn default() -> Self {
        Self {
            source: SourceKind::Twin,
            rate_hz: 1000.0,
            silence_ms: 20.0,
            serial: SerialConfig::default(),
            labjack: LabjackConfig::default(),
        }
    }
}

impl Default for SerialConfig {
    fn default() -> Self {
        Self { port: "/dev/ttyACM0".into(), baud: 921_600, latency_us: 0.0 }
    }
}

impl AcquisitionConfig {
    /// Time without samples after which the source counts as down; at least five periods, whatever the rate of
    /// the source.
    pub fn silence(&self) -> Duration {
        Duration::from_secs_f64(self.silence_ms * 1e-3)
    }

    /// When the lack of samples is reported, at the configured rate.
    pub fn silence_times(&self) -> SilenceTimes {
        SilenceTimes::new(self.rate_hz, self.silence())
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("rate_hz", self.rate_hz, 1.0..=20_000.0);
        at.number("silence_ms", self.silence_ms, 1.0..=10_000.0);
        self.serial.check(at.section("serial"));
        self.labjack.check(at.section("labjack"));
    }
}

impl SerialConfig {
    fn check(&self, mut at: Checker<'_>) {
        let port = self.port.to_string_lossy();
        at.demand(!port.trim().is_empty(), "port", format!("{port:?}"), "the path of a serial port");
        at.number("baud", self.baud, 9600.0..=20_000_000.0);
        at.number("latency_us", self.latency_us, 0.0..=1_000_000.0);
    }
}
