//! Settings of the session.

use std::time::Duration;

use trifacet_core::centering::OnExit;
use trifacet_core::signals::Identity;
use trifacet_wire::channel::{Role, SIGNALS};

use super::calibration::{Calibration, RANGES_V};
use super::outputs::Outputs;
use super::registers::Value;
use super::scans::TIMER_ENTRIES;
use super::stream::MOST_SAMPLES;
use crate::acquisition::in_flight::most_in_flight;
use crate::config::{Config, LabjackOutputs, SteeringKind};

/// Packets per second: with more scans, a packet has several.
const PACKETS_HZ: f64 = 1000.0;
/// The buffer of the device holds the scans of this time, seconds: older ones are of no use.
const BUFFER_S: f64 = 0.4;

/// What the watchdog of the device must be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Watchdog {
    /// As it is: the outputs are not used.
    AsItIs,
    /// Off: the outputs hold.
    Off,
    /// It sets the outputs.
    Parks {
        /// Time without communication, seconds.
        timeout_s: u32,
        /// The voltages.
        at: [Value; 2],
    },
}

/// Settings of the session.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Host and port of the registers, for messages.
    pub address: String,
    /// Scans per second.
    pub rate_hz: f64,
    /// Constant delay from a scan to its arrival, nanoseconds.
    pub latency_ns: i64,
    /// Time without scans after which they have stalled; at least five periods.
    pub silence: Duration,
    /// The inputs, and what they measure.
    pub inputs: Vec<(u8, Role)>,
    /// Range of the inputs, volts.
    pub range_v: f64,
    /// Settling time, microseconds; 0: chosen by the device.
    pub settling_us: f64,
    /// Resolution, 0 to 8.
    pub resolution: u8,
    /// Time from one entry of the scan list to the next, nanoseconds.
    pub interval_ns: f64,
    /// The steering outputs, and their parking position; `None` if the stage is not there.
    pub outputs: Option<(Outputs, [Value; 2])>,
    /// The watchdog.
    pub watchdog: Watchdog,
    /// Largest number of commands that wait for an acknowledgement. Above 0.
    pub most_in_flight: usize,
}

impl From<&Config> for Settings {
    fn from(config: &Config) -> Self {
        let labjack = &config.acquisition.labjack;
        let readback = [Role::Steering(0), Role::Steering(1)];
        let inputs = labjack.inputs.into_iter().zip(SIGNALS);
        let readback = labjack.readback.into_iter().flat_map(|inputs| inputs.into_iter().zip(readback));
        let outputs = (config.steering.kind == SteeringKind::Outputs).then(|| {
            let outputs = Outputs::of(labjack);
            let parts = config.steering.park_um.map(|um| um / config.steering.full_scale_um);
            (outputs, outputs.values_at(parts))
        });
        let watchdog = match outputs {
            None => Watchdog::AsItIs,
            Some((_, at))
                if config.steering.on_lease == OnExit::Park && labjack.outputs == LabjackOutputs::Dac =>
            {
                Watchdog::Parks { timeout_s: labjack.watchdog_s, at }
            }
            Some(_) => Watchdog::Off,
        };
        Self {
            address: format!("{}:{}", labjack.address, labjack.port),
            rate_hz: config.acquisition.rate_hz,
            latency_ns: (labjack.latency_us * 1e3).round() as i64,
            silence: config.acquisition.silence(),
            inputs: inputs.chain(readback).collect(),
            range_v: labjack.range_v,
            settling_us: labjack.settling_us,
            resolution: labjack.resolution_index,
            interval_ns: labjack.interval_us * 1e3,
            outputs,
            watchdog,
            most_in_flight: most_in_flight(config),
        }
    }
}

impl Settings {
    /// Entries of the scan list.
    pub fn entries(&self) -> usize {
        TIMER_ENTRIES + self.inputs.len()
    }

    /// Scans in a packet: one for the shortest delay, more at high rates.
    pub fn scans_per_packet(&self) -> u32 {
        let most = MOST_SAMPLES / self.entries();
        ((self.rate_hz / PACKETS_HZ).ceil() as usize).clamp(1, most.max(1)) as u32
    }

    /// Size of the buffer of the device, bytes.
    pub fn buffer_bytes(&self) -> u32 {
        let bytes = (BUFFER_S * self.rate_hz * self.entries() as f64 * 2.0) as u32;
        (bytes.max(1024).next_power_of_two() / 2).clamp(1024, 32_768)
    }

    /// The place of the constants of this range in flash.
    pub fn range_place(&self) -> usize {
        RANGES_V.iter().position(|range| *range == self.range_v).unwrap_or(0)
    }

    /// The device as a source of scans.
    pub fn identity(
        &self,
        name: String,
        rate_hz: f64,
        calibration: &Calibration,
        simulated: bool,
    ) -> Identity {
        let skew = |place: usize| ((place + TIMER_ENTRIES) as f64 * self.interval_ns).round() as u32;
        Identity {
            name,
            rate_hz,
            converter: calibration.converter(),
            roles: self.inputs.iter().map(|(_, role)| *role).collect(),
            skew_ns: (0..self.inputs.len()).map(skew).collect(),
            output_bits: self.outputs.map_or(16, |(outputs, _)| outputs.bits),
            simulated,
        }
    }
}
