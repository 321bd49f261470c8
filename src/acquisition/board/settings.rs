//! Settings of the session.

use std::time::Duration;

use crate::acquisition::in_flight::most_in_flight;
use crate::config::{Config, SteeringKind};

/// Settings of the session.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Scans per second.
    pub rate_hz: f64,
    /// Baud rate of the serial port; `None` on a network, which has none.
    pub baud: Option<u32>,
    /// Constant delay from a scan to its arrival, nanoseconds.
    pub latency_ns: i64,
    /// Time without scans after which they have stalled; at least five periods.
    pub silence: Duration,
    /// Parking position as a fraction of full scale.
    pub park: [f64; 2],
    /// Largest number of commands that wait for an acknowledgement. Above 0.
    pub most_in_flight: usize,
}

impl From<&Config> for Settings {
    fn from(config: &Config) -> Self {
        Self {
            rate_hz: config.acquisition.rate_hz,
            baud: config.acquisition.board().and_then(|place| place.baud()),
            latency_ns: (config.acquisition.board_latency_us() * 1e3).round() as i64,
            silence: config.acquisition.silence(),
            most_in_flight: most_in_flight(config),
            park: match config.steering.kind {
                SteeringKind::Outputs => config.steering.park_um.map(|um| um / config.steering.full_scale_um),
                SteeringKind::Gcs | SteeringKind::Tilt => [0.0; 2], // with another stage the outputs are never commanded
            },
        }
    }
}
