//! `[channels]`: conversion of the converter's codes to spots and powers.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use trifacet_core::channels::Amplifier;

use super::check::{Checker, above_zero};
use super::file::read_regular;

/// Settings of `[channels]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ChannelsConfig {
    /// A PSD gives no position if its sum signal, less the dark reading, is below this, volts.
    pub sum_threshold_v: f64,
    /// Fraction of the converter's range above which a code counts as clipped.
    pub clip_limit: f64,
    /// Power per volt of the sum signal, mW/V.
    pub power_mw_per_v: f64,
    /// Position of the stage per volt of its readback signal, um/V.
    pub readback_um_per_v: f64,
    /// Settings of PSD A.
    pub a: PsdChannelsConfig,
    /// Settings of PSD B.
    pub b: PsdChannelsConfig,
    /// Settings of PSD C.
    pub c: PsdChannelsConfig,
}

/// Settings of `[channels.a]`, `[channels.b]` or `[channels.c]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PsdChannelsConfig {
    /// Kind of amplifier, which determines what u and v mean.
    pub amplifier: Amplifier,
    /// Voltage at the edge of the PSD, for a normalised amplifier.
    pub full_scale_v: f64,
    /// Gains of u, v and power relative to the nominal ones. A negative gain reverses the axis.
    pub gain: [f64; 3],
    /// Readings of the u, v and sum channels with the laser off, volts. `trifacet dark` measures them.
    pub dark_v: [f64; 3],
    /// Correction table for the non-linearity of the PSD: a CSV file, relative to the configuration file.
    pub correction: Option<PathBuf>,
}

impl Default for ChannelsConfig {
    fn default() -> Self {
        Self {
            sum_threshold_v: 0.05,
            clip_limit: 0.999,
            power_mw_per_v: 0.0667,
            readback_um_per_v: 50.0,
            a: PsdChannelsConfig::default(),
            b: PsdChannelsConfig::default(),
            c: PsdChannelsConfig::default(),
        }
    }
}

impl Default for PsdChannelsConfig {
    fn default() -> Self {
        Self {
            amplifier: Amplifier::Normalised,
            full_scale_v: 10.0,
            gain: [1.0; 3],
            dark_v: [0.0; 3],
            correction: None,
        }
    }
}

impl ChannelsConfig {
    /// The channels of PSDs A, B and C, in this order.
    pub fn psds(&self) -> [&PsdChannelsConfig; 3] {
        [&self.a, &self.b, &self.c]
    }

    pub(super) fn psds_mut(&mut self) -> [&mut PsdChannelsConfig; 3] {
        [&mut self.a, &mut self.b, &mut self.c]
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("sum_threshold_v", self.sum_threshold_v, above_zero(100.0));
        at.number("clip_limit", self.clip_limit, above_zero(1.0));
        at.number("power_mw_per_v", self.power_mw_per_v, above_zero(1e6));
        at.number("readback_um_per_v", self.readback_um_per_v, above_zero(1e6));
        for (name, psd) in ["a", "b", "c"].into_iter().zip(self.psds()) {
            psd.check(at.section(name));
        }
    }

    /// Checks that the correction tables can be read. Blocks.
    pub(super) fn check_tables(&self, mut at: Checker<'_>) {
        for (name, psd) in ["a", "b", "c"].into_iter().zip(self.psds()) {
            if let Some(path) = &psd.correction
                && let Err(error) = read_regular(path)
            {
                let allowed = format!("a CSV file, relative to this one: {}: {error}", path.display());
                at.section(name).demand(false, "correction", path.display(), allowed);
            }
        }
    }
}

impl PsdChannelsConfig {
    fn check(&self, mut at: Checker<'_>) {
        at.number("full_scale_v", self.full_scale_v, above_zero(100.0));
        at.numbers("gain", &self.gain, -100.0..=100.0);
        for (i, gain) in self.gain.iter().enumerate() {
            let useful = if i == 2 { *gain >= 0.01 } else { gain.abs() >= 0.01 };
            let allowed = if i == 2 { "0.01 to 100 (a power)" } else { "0.01 to 100 or -100 to -0.01" };
            let in_range = (-100.0..=100.0).contains(gain); // otherwise the range check reports it
            at.demand(useful || !in_range, &format!("gain[{i}]"), format!("{gain:?}"), allowed);
        }
        at.numbers("dark_v", &self.dark_v, -100.0..=100.0);
    }
}
