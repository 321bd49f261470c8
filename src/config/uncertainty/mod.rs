//! `[uncertainty]`: what the readings do not tell about the uncertainty of a pose relative to the tare. Read by
//! `trifacet budget` and for the systematic part of the frames. An absent key means that nothing is stated: the budget
//! then names what it does not cover. [`Components`] are the quantities that the whole configuration states.

mod components;
mod quantity;

pub use components::{Components, NotCovered};
pub use quantity::{Group, Unit};
use serde::{Deserialize, Serialize};

use super::check::{Checker, above_zero};

/// Settings of `[uncertainty]`. All are standard uncertainties unless they are called a range.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UncertaintyConfig {
    /// Number of samples that were averaged in the tare.
    pub tare_readings: u32,
    /// Degrees of freedom with which `estimation.spot_noise_um` and `power_noise` are known. `None`: infinitely many.
    pub noise_dof: Option<f64>,
    /// The temperature stays within plus and minus this of that of the tare, kelvins.
    pub temperature_range_k: Option<f64>,
    /// Drift of the zero of each coordinate of a PSD, in millionths of its side per kelvin.
    pub psd_zero_ppm_per_k: f64,
    /// Drift of the gain of the PSDs, millionths per kelvin.
    pub psd_gain_ppm_per_k: f64,
    /// Expansion of the structure between mirror and PSDs, millionths per kelvin.
    pub psd_distance_ppm_per_k: f64,
    /// Difference in height between the mounts of the PSDs and that of the mirror, millimetres.
    pub height_difference_mm: Option<f64>,
    /// Expansion of the structure over this height, millionths per kelvin.
    pub height_ppm_per_k: f64,
    /// Direction of the beam about each axis across it, since the tare, microradians.
    pub pointing_urad: Option<f64>,
    /// Diameter of the beam, percent.
    pub diameter_percent: f64,
    /// Offset of the beam from the apex on each axis, micrometres. `None`: `centering.lock_limit_um`.
    pub beam_offset_um: Option<f64>,
    /// Scale of the translations of the reference to which the head was calibrated, on each axis, millionths.
    pub reference_scale_ppm: Option<f64>,
    /// Scale of the angles of the reference, about each axis, millionths.
    pub reference_angle_ppm: Option<f64>,
    /// Squareness of the reference: the angle between two of its axes, microradians.
    pub reference_squareness_urad: Option<f64>,
    /// Each coordinate of `frames.tool.translation_mm`, micrometres.
    pub lever_arm_um: Option<f64>,
    /// What `channels.*.dark_v` leaves of the dark offset of each sum signal, millivolts.
    pub dark_mv: Option<f64>,
    /// Resolution of the converter, bits. `None`: that of the twin, if the twin is the source.
    pub converter_bits: Option<u8>,
    /// Range of the converter, plus and minus, volts. `None`: that of the twin, if the twin is the source.
    pub converter_range_v: Option<f64>,
    /// What the correction tables leave of the error of each coordinate, between their points too, micrometres.
    pub map_residue_um: f64,
}

impl Default for UncertaintyConfig {
    fn default() -> Self {
        Self {
            tare_readings: 100,
            noise_dof: None,
            temperature_range_k: None,
            psd_zero_ppm_per_k: 40.0,
            psd_gain_ppm_per_k: 40.0,
            psd_distance_ppm_per_k: 23.0,
            height_difference_mm: None,
            height_ppm_per_k: 23.0,
            pointing_urad: None,
            diameter_percent: 5.0,
            beam_offset_um: None,
            reference_scale_ppm: None,
            reference_angle_ppm: None,
            reference_squareness_urad: None,
            lever_arm_um: None,
            dark_mv: None,
            converter_bits: None,
            converter_range_v: None,
            map_residue_um: 0.014,
        }
    }
}

impl UncertaintyConfig {
    /// Whether a key without default is set.
    pub fn states_anything(&self) -> bool {
        let keys = [
            self.temperature_range_k,
            self.pointing_urad,
            self.beam_offset_um,
            self.reference_scale_ppm,
            self.reference_angle_ppm,
            self.reference_squareness_urad,
            self.lever_arm_um,
            self.dark_mv,
        ];
        keys.iter().any(Option::is_some)
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("tare_readings", self.tare_readings, 1.0..=1_000_000_000.0);
        at.optional("noise_dof", self.noise_dof, 1.0..=1_000_000_000.0);
        at.optional("temperature_range_k", self.temperature_range_k, 0.0..=100.0);
        at.number("psd_zero_ppm_per_k", self.psd_zero_ppm_per_k, 0.0..=100_000.0);
        at.number("psd_gain_ppm_per_k", self.psd_gain_ppm_per_k, 0.0..=100_000.0);
        at.number("psd_distance_ppm_per_k", self.psd_distance_ppm_per_k, 0.0..=100_000.0);
        at.optional("height_difference_mm", self.height_difference_mm, 0.0..=10_000.0);
        at.number("height_ppm_per_k", self.height_ppm_per_k, 0.0..=100_000.0);
        at.optional("pointing_urad", self.pointing_urad, 0.0..=100_000.0);
        at.number("diameter_percent", self.diameter_percent, 0.0..=50.0);
        at.optional("beam_offset_um", self.beam_offset_um, 0.0..=1000.0);
        at.optional("reference_scale_ppm", self.reference_scale_ppm, 0.0..=100_000.0);
        at.optional("reference_angle_ppm", self.reference_angle_ppm, 0.0..=100_000.0);
        at.optional("reference_squareness_urad", self.reference_squareness_urad, 0.0..=100_000.0);
        at.optional("lever_arm_um", self.lever_arm_um, 0.0..=100_000.0);
        at.optional("dark_mv", self.dark_mv, 0.0..=10_000.0);
        at.optional("converter_bits", self.converter_bits, 8.0..=24.0);
        at.optional("converter_range_v", self.converter_range_v, above_zero(100.0));
        at.number("map_residue_um", self.map_residue_um, 0.0..=1000.0);
    }
}
