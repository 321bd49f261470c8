//! `[acquisition]`: the source of the samples.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use trifacet_core::pipeline::SilenceTimes;

use super::LabjackConfig;
use super::board_place::LONGEST_SOCKET;
use super::check::Checker;
use super::{BoardPlace, Destination};

/// Kind of source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SourceKind {
    /// The digital twin.
    Twin,
    /// An acquisition board at `port`, `address` or `socket`.
    Board,
    /// An acquisition board on a serial port, with the keys of `[acquisition.serial]`.
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
    /// Device path of the serial port of the board.
    pub port: Option<PathBuf>,
    /// Host and TCP port of the board, as an alternative.
    pub address: Option<Destination>,
    /// Path of the Unix socket of the board, as an alternative.
    pub socket: Option<PathBuf>,
    /// Line rate of `port`, bits per second. A byte takes ten bits.
    pub baud: u32,
    /// Constant delay from the tick of a scan to the arrival of its last byte, microseconds. It is subtracted
    /// from arrival times.
    pub latency_us: f64,
    /// Settings of the board with `source = "serial"`.
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
        let serial = SerialConfig::default();
        Self {
            source: SourceKind::Twin,
            rate_hz: 1000.0,
            silence_ms: 20.0,
            port: None,
            address: None,
            socket: None,
            baud: serial.baud,
            latency_us: serial.latency_us,
            serial,
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

    /// Where the board is; `None` if the source is no board.
    pub fn board(&self) -> Option<BoardPlace> {
        match self.source {
            SourceKind::Serial => {
                Some(BoardPlace::Serial { port: self.serial.port.clone(), baud: self.serial.baud })
            }
            SourceKind::Board => {
                let port = self.port.clone().map(|port| BoardPlace::Serial { port, baud: self.baud });
                let address = || self.address.clone().map(BoardPlace::Tcp);
                let socket = || self.socket.clone().map(BoardPlace::Unix);
                port.or_else(address).or_else(socket)
            }
            SourceKind::Twin | SourceKind::Labjack | SourceKind::Replay => None,
        }
    }

    /// Constant delay from the tick of a scan of the board to its arrival, microseconds.
    pub fn board_latency_us(&self) -> f64 {
        if self.source == SourceKind::Serial { self.serial.latency_us } else { self.latency_us }
    }

    /// The key of this section that names the place of the board, and the key of its line rate.
    pub(super) fn board_keys(&self) -> [&'static str; 2] {
        match (self.source, &self.address, &self.socket) {
            (SourceKind::Serial, ..) => ["serial.port", "serial.baud"],
            (_, Some(_), _) => ["address", "baud"],
            (_, None, Some(_)) => ["socket", "baud"],
            (_, None, None) => ["port", "baud"],
        }
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("rate_hz", self.rate_hz, 1.0..=20_000.0);
        at.number("silence_ms", self.silence_ms, 1.0..=10_000.0);
        self.check_place(&mut at);
        at.number("baud", self.baud, 9600.0..=20_000_000.0);
        at.number("latency_us", self.latency_us, 0.0..=1_000_000.0);
        self.serial.check(at.section("serial"));
        self.labjack.check(at.section("labjack"));
    }

    /// The board is at one place.
    fn check_place(&self, at: &mut Checker<'_>) {
        let quoted = |path: &Path| format!("{:?}", path.display().to_string());
        if let Some(port) = &self.port {
            let named = !port.to_string_lossy().trim().is_empty();
            at.demand(named, "port", quoted(port), "the path of a serial port");
        }
        if let Some(address) = &self.address {
            let fine = !address.is_multicast() && address.port > 0;
            at.demand(fine, "address", format!("\"{address}\""), ADDRESS);
        }
        if let Some(path) = &self.socket {
            let fine = path.is_absolute() && path.as_os_str().len() <= LONGEST_SOCKET;
            let allowed = format!("an absolute path of at most {LONGEST_SOCKET} bytes");
            at.demand(fine, "socket", quoted(path), allowed);
        }
        let places = [
            ("port", self.port.as_deref().map(quoted)),
            ("address", self.address.as_ref().map(|address| format!("\"{address}\""))),
            ("socket", self.socket.as_deref().map(quoted)),
        ];
        let mut set = places.into_iter().filter_map(|(key, found)| Some((key, found?)));
        match (set.next(), set.next()) {
            (Some((first, _)), Some((second, found))) => {
                let allowed = format!("absent, because acquisition.{first} is set: a board is at one place");
                at.demand(false, second, found, allowed);
            }
            (None, _) if self.source == SourceKind::Board => {
                let allowed = "the path of a serial port, or acquisition.address or acquisition.socket instead: \
                               acquisition.source = \"board\" needs one of them";
                at.agree(false, "port", &["source"], "absent", allowed);
            }
            _ => {}
        }
    }
}

const ADDRESS: &str = "a host and its TCP port, such as \"192.168.1.20:7365\" or \"daq.lan:7365\"";

impl SerialConfig {
    fn check(&self, mut at: Checker<'_>) {
        let port = self.port.to_string_lossy();
        at.demand(!port.trim().is_empty(), "port", format!("{port:?}"), "the path of a serial port");
        at.number("baud", self.baud, 9600.0..=20_000_000.0);
        at.number("latency_us", self.latency_us, 0.0..=1_000_000.0);
    }
}
