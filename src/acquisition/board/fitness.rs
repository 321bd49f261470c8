//! Whether a board can be used.

use super::{BoardIdentity, Settings, required_baud};
use crate::acquisition::{
    MAX_CHANNELS, Role,
    scan::{Identity, SIGNALS},
};

/// The board's clock has to resolve the time of a scan, and its ticks have to be told apart.
const TICK_HZ: std::ops::RangeInclusive<u32> = 10_000..=1_000_000_000;

/// Bits of converters and outputs.
const BITS: std::ops::RangeInclusive<u8> = 8..=24;

impl BoardIdentity {
    /// Says what is wrong with the board, if anything is: what it has, and what is needed.
    pub fn check(&self, settings: &Settings) -> Result<(), String> {
        let channels = self.roles.len();
        if !(SIGNALS.len()..=MAX_CHANNELS).contains(&channels) {
            return Err(format!("it has {channels} channels; 9 to {MAX_CHANNELS} can be used"));
        }
        for signal in SIGNALS {
            let count = self.roles.iter().filter(|role| **role == signal).count();
            if count != 1 {
                return Err(format!(
                    "{count} of its channels are {signal}; each signal is needed exactly once"
                ));
            }
        }
        self.check_numbers()?;
        self.check_rate(settings)
    }

    fn check_numbers(&self) -> Result<(), String> {
        let (bits, output_bits) = (self.converter.bits, self.output_bits);
        if !BITS.contains(&bits) {
            return Err(format!("its converter has {bits} bits; 8 to 24 can be used"));
        }
        if !BITS.contains(&output_bits) {
            return Err(format!("its steering outputs have {output_bits} bits; 8 to 24 can be used"));
        }
        if self.converter.range_v <= 0.0 {
            return Err("its converter has a range of 0 V".into());
        }
        if !TICK_HZ.contains(&self.tick_hz) {
            return Err(format!("its clock ticks at {} Hz; 10 kHz to 1 GHz can be used", self.tick_hz));
        }
        Ok(())
    }

    fn check_rate(&self, settings: &Settings) -> Result<(), String> {
        let rate_hz = settings.rate_hz;
        let [slowest, fastest] = self.rate_mhz.map(|rate| f64::from(rate) * 1e-3);
        if !(slowest..=fastest).contains(&rate_hz) {
            return Err(format!("it samples at {slowest} to {fastest} Hz; acquisition.rate_hz is {rate_hz}"));
        }
        let (channels, needed) = (self.roles.len(), required_baud(self.roles.len(), rate_hz));
        if settings.baud < needed {
            return Err(format!(
                "its {channels} channels at {rate_hz} Hz need {needed} baud; acquisition.serial.baud is {}",
                settings.baud
            ));
        }
        Ok(())
    }

    /// As the rest of the house knows a source.
    pub fn identity(&self, rate_hz: f64) -> Identity {
        Identity {
            name: self.name.clone(),
            rate_hz,
            converter: self.converter,
            roles: self.roles.clone(),
            skew_ns: self.skew_ns.clone(),
            output_bits: self.output_bits,
            simulated: self.simulated,
        }
    }

    /// The output codes of a position given in parts of full scale.
    pub fn output_codes(&self, parts: [f64; 2]) -> [i32; 2] {
        let full = f64::from(1_u32 << (self.output_bits - 1));
        parts.map(|part| (part * full).round().clamp(-full, full - 1.0) as i32)
    }
}

impl std::fmt::Display for Role {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let psd = |n: &u8| char::from(b'A' + n);
        match self {
            Role::U(n) => write!(f, "u of PSD {}", psd(n)),
            Role::V(n) => write!(f, "v of PSD {}", psd(n)),
            Role::Sum(n) => write!(f, "the sum of PSD {}", psd(n)),
            Role::Steering(axis) => write!(f, "the steering's {}", if *axis == 0 { "x" } else { "y" }),
            Role::Auxiliary => write!(f, "auxiliary"),
        }
    }
}
