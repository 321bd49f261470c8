//! `[acquisition.labjack]`: a LabJack T7.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::check::Checker;

/// The two outputs that move the stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LabjackOutputs {
    /// DAC0 and DAC1, 0 to 5 V, 12 bits; 2.5 V is the middle.
    Dac,
    /// The two outputs of an LJTick-DAC, +-10 V, 14 bits.
    LjtickDac,
}

/// Settings of `[acquisition.labjack]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LabjackConfig {
    /// Address or name of the device.
    pub address: String,
    /// Port of its registers (Modbus TCP).
    pub port: u16,
    /// Port of its stream.
    pub stream_port: u16,
    /// The analog inputs of u, v and sum of PSD A, then of B, then of C.
    pub inputs: [u8; 9],
    /// The analog inputs of the readback of the stage, x and y.
    pub readback: Option<[u8; 2]>,
    /// Range of all inputs, volts: 10, 1, 0.1 or 0.01.
    pub range_v: f64,
    /// Settling time before each input, microseconds; 0: chosen by the device.
    pub settling_us: f64,
    /// Resolution index of the stream.
    pub resolution_index: u8,
    /// Time from one entry of the scan list to the next, microseconds.
    pub interval_us: f64,
    /// Constant delay from a scan to its arrival, microseconds. It is subtracted from arrival times.
    pub latency_us: f64,
    /// The outputs that move the stage.
    pub outputs: LabjackOutputs,
    /// First of the two digital lines to which the LJTick-DAC is connected.
    pub ljtick_dio: u8,
    /// Time without communication after which the watchdog of the device parks the outputs, seconds.
    pub watchdog_s: u32,
}

impl Default for LabjackConfig {
    fn default() -> Self {
        Self {
            address: "192.168.1.207".into(),
            port: 502,
            stream_port: 702,
            inputs: [0, 1, 2, 3, 4, 5, 6, 7, 8],
            readback: None,
            range_v: 10.0,
            settling_us: 0.0,
            resolution_index: 0,
            interval_us: 10.0,
            latency_us: 0.0,
            outputs: LabjackOutputs::Dac,
            ljtick_dio: 0,
            watchdog_s: 2,
        }
    }
}

impl LabjackConfig {
    /// The analog inputs in the order of their channels.
    pub fn channels(&self) -> Vec<u8> {
        self.inputs.into_iter().chain(self.readback.into_iter().flatten()).collect()
    }

    /// Entries of the scan list: the inputs, and the timer of the device as two.
    pub fn entries(&self) -> usize {
        self.channels().len() + 2
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        let address = &self.address;
        let fine = !address.is_empty() && !address.contains([':', '/', ' '])
            || address.parse::<std::net::IpAddr>().is_ok();
        at.demand(fine, "address", format!("{address:?}"), "an IP address or a name, without a port");
        at.number("port", self.port, 1.0..=65_535.0);
        at.number("stream_port", self.stream_port, 1.0..=65_535.0);
        let inputs = self.inputs.map(f64::from);
        at.numbers("inputs", &inputs, 0.0..=13.0);
        let readback = self.readback.map(|inputs| inputs.map(f64::from));
        at.optional_numbers("readback", readback.as_ref().map(|inputs| &inputs[..]), 0.0..=13.0);
        let channels = self.channels();
        let different = channels.iter().collect::<BTreeSet<_>>().len() == channels.len();
        at.agree(
            different,
            "inputs",
            &["readback"],
            format!("{channels:?}, readback included"),
            "inputs that differ",
        );
        let ranges = [10.0, 1.0, 0.1, 0.01];
        at.demand(ranges.contains(&self.range_v), "range_v", self.range_v, "10, 1, 0.1 or 0.01");
        at.number("settling_us", self.settling_us, 0.0..=4400.0);
        at.number("resolution_index", self.resolution_index, 0.0..=8.0);
        at.number("interval_us", self.interval_us, 1.0..=10_000.0);
        at.number("latency_us", self.latency_us, 0.0..=1_000_000.0);
        at.number("ljtick_dio", self.ljtick_dio, 0.0..=21.0);
        at.number("watchdog_s", self.watchdog_s, 1.0..=3600.0);
    }
}
