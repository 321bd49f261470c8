//! The true head of the twin, apart from what the estimator believes: `[twin.psd]`, `[twin.beam]`, `[twin.stage]`,
//! `[twin.tolerances]`, `[twin.temperature]`. (`[twin.head]` has the keys of `[head]`.)

use serde::{Deserialize, Serialize};

use super::check::{Checker, above_zero};
use super::{Config, HeadConfig, TransformConfig};

/// Settings of `[twin.psd]`: the true gains and distortions of the PSDs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinPsds {
    /// PSD A.
    pub a: TwinPsd,
    /// PSD B.
    pub b: TwinPsd,
    /// PSD C.
    pub c: TwinPsd,
}

/// Settings of `[twin.psd.a]`, `[twin.psd.b]` or `[twin.psd.c]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinPsd {
    /// Factors by which u, v and power read too large.
    pub gain: [f64; 3],
    /// Distortion outwards at the middle of an edge, micrometres; added to `twin.bow_um`.
    pub bow_um: f64,
    /// Distortion that a symmetric PSD would not have, at the middle of an edge, micrometres: of u by x^2, x y, y^2,
    /// of v by x^2, x y, y^2, with x and y in units of half the side.
    pub asymmetry_um: [f64; 6],
}

impl Default for TwinPsd {
    fn default() -> Self {
        Self { gain: [1.0; 3], bow_um: 0.0, asymmetry_um: [0.0; 6] }
    }
}

/// Settings of `[twin.beam]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinBeam {
    /// c and s of the covariance `sigma^2 exp([[c, s], [s, -c]])` across the light; zeros: a round beam.
    pub ellipse: [f64; 2],
}

/// Settings of `[twin.stage]`: the stage that carries the mirror. Poses of the twin are those of its table in its
/// axes. The keys mean what those of `[frames]` mean.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinStage {
    /// The sensor's world frame in the axes of the stage.
    pub base: TransformConfig,
    /// The table of the stage in the frame of the mirror.
    pub tool: TransformConfig,
}

/// Settings of `[twin.tolerances]`: a head with random errors. Each number is one standard deviation; values beyond
/// two of them are drawn as two.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinTolerances {
    /// Each seed is another head.
    pub seed: u64,
    /// Place of each PSD along each axis, millimetres.
    pub psd_shift_mm: f64,
    /// Rotation of each PSD about each axis, milliradians.
    pub psd_turn_mrad: f64,
    /// Rotation of each facet, towards the zenith and about it, milliradians.
    pub facet_turn_mrad: f64,
    /// Direction of the light about each axis, milliradians.
    pub beam_tilt_mrad: f64,
    /// Diameter of the beam, percent.
    pub beam_diameter_percent: f64,
    /// Each parameter of the ellipse of the beam, percent.
    pub ellipticity_percent: f64,
    /// Gain of the power of B and C relative to A, percent.
    pub power_gain_percent: f64,
    /// Gain of each coordinate of each PSD, percent.
    pub psd_gain_percent: f64,
    /// Least and largest distortion outwards at the middle of an edge, micrometres; uniform between them.
    pub psd_bow_um: [f64; 2],
    /// Each term of the asymmetry of a PSD, micrometres.
    pub psd_asymmetry_um: f64,
    /// Ripple of each coordinate of a PSD, rms, micrometres.
    pub psd_ripple_um: f64,
    /// Shortest and longest wave of this ripple, millimetres.
    pub psd_ripple_mm: [f64; 2],
    /// Rotation of the axes of the stage against those of the head, about each axis, milliradians.
    pub stage_turn_mrad: f64,
    /// Distance of the table's origin from the apex along each axis, millimetres.
    pub stage_lever_mm: f64,
}

impl Default for TwinTolerances {
    fn default() -> Self {
        Self {
            seed: 1,
            psd_shift_mm: 0.5,
            psd_turn_mrad: 5.0,
            facet_turn_mrad: 0.5,
            beam_tilt_mrad: 1.0,
            beam_diameter_percent: 5.0,
            ellipticity_percent: 2.0,
            power_gain_percent: 2.0,
            psd_gain_percent: 0.5,
            psd_bow_um: [60.0, 150.0],
            psd_asymmetry_um: 20.0,
            psd_ripple_um: 1.5,
            psd_ripple_mm: [2.0, 5.0],
            stage_turn_mrad: 0.0,
            stage_lever_mm: 0.0,
        }
    }
}

/// Settings of `[twin.temperature]`: the temperature of the head after the start, and what it changes. The signs of the
/// changes are random, by the seed of the twin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinTemperature {
    /// Warming after the start, kelvin.
    pub warm_up_k: f64,
    /// Its time constant, seconds.
    pub warm_up_s: f64,
    /// Amplitude of a sine, as by an air conditioner, kelvin.
    pub swing_k: f64,
    /// Its period, seconds.
    pub swing_s: f64,
    /// Drift of each coordinate of each PSD, micrometres per kelvin.
    pub psd_zero_um_per_k: f64,
    /// Drift of the gain of each coordinate of each PSD, parts per million per kelvin.
    pub psd_gain_ppm_per_k: f64,
    /// Growth of the distances of the PSDs, parts per million per kelvin.
    pub distance_ppm_per_k: f64,
    /// Rise of the PSDs against the mount of the mirror, micrometres per kelvin.
    pub height_um_per_k: f64,
    /// Tilt of the light, microradians per kelvin.
    pub beam_tilt_urad_per_k: f64,
    /// Signal of the temperature channel, volts per kelvin.
    pub channel_v_per_k: f64,
}

impl Default for TwinTemperature {
    fn default() -> Self {
        Self {
            warm_up_k: 0.0,
            warm_up_s: 1800.0,
            swing_k: 0.0,
            swing_s: 900.0,
            psd_zero_um_per_k: 0.5,
            psd_gain_ppm_per_k: 40.0,
            distance_ppm_per_k: 23.0,
            height_um_per_k: 1.2,
            beam_tilt_urad_per_k: 1.0,
            channel_v_per_k: 0.1,
        }
    }
}

impl Config {
    /// The true geometry of the twin, before random errors. That of a head of its own does not follow `[head]`, which a
    /// calibration changes.
    pub fn twin_geometry(&self) -> HeadConfig {
        match &self.twin.head {
            Some(head) => head.clone(),
            None if self.twin.has_own_head() => {
                HeadConfig { psd_size_mm: self.head.psd_size_mm, ..HeadConfig::default() }
            }
            None => self.head.clone(),
        }
    }

    /// Factors by which u, v and power of PSDs A, B, C read too large in the twin, before random errors: those that
    /// `[channels]` corrects, or those of a head of its own.
    pub fn twin_gains(&self) -> [[f64; 3]; 3] {
        if self.twin.has_own_head() {
            self.twin.psd.clone().unwrap_or_default().each().map(|psd| psd.gain)
        } else {
            self.channels.psds().map(|psd| psd.gain.map(f64::recip))
        }
    }
}

impl TwinPsds {
    /// PSDs A, B, C.
    pub fn each(&self) -> [&TwinPsd; 3] {
        [&self.a, &self.b, &self.c]
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        for (name, psd) in ["a", "b", "c"].into_iter().zip(self.each()) {
            psd.check(at.section(name));
        }
    }
}

impl TwinPsd {
    fn check(&self, mut at: Checker<'_>) {
        at.numbers("gain", &self.gain, -10.0..=10.0);
        let [u, v, power] = self.gain;
        let usable = u.abs() >= 0.1 && v.abs() >= 0.1 && power >= 0.1;
        at.demand(
            usable,
            "gain",
            format_args!("{:?}", self.gain),
            "0.1 or more; u and v may be negative, the power may not",
        );
        at.number("bow_um", self.bow_um, -1000.0..=1000.0);
        at.numbers("asymmetry_um", &self.asymmetry_um, -1000.0..=1000.0);
    }
}

impl TwinBeam {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.numbers("ellipse", &self.ellipse, -1.0..=1.0);
    }
}

impl TwinStage {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        self.base.check(at.section("base"));
        self.tool.check(at.section("tool"));
    }
}

impl TwinTolerances {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        // The integers that a double represents exactly.
        at.number("seed", self.seed as f64, 0.0..=9_007_199_254_740_992.0);
        at.number("psd_shift_mm", self.psd_shift_mm, 0.0..=10.0);
        at.number("psd_turn_mrad", self.psd_turn_mrad, 0.0..=100.0);
        at.number("facet_turn_mrad", self.facet_turn_mrad, 0.0..=20.0);
        at.number("beam_tilt_mrad", self.beam_tilt_mrad, 0.0..=20.0);
        at.number("beam_diameter_percent", self.beam_diameter_percent, 0.0..=40.0);
        at.number("ellipticity_percent", self.ellipticity_percent, 0.0..=40.0);
        at.number("power_gain_percent", self.power_gain_percent, 0.0..=40.0);
        at.number("psd_gain_percent", self.psd_gain_percent, 0.0..=20.0);
        at.numbers("psd_bow_um", &self.psd_bow_um, -1000.0..=1000.0);
        at.number("psd_asymmetry_um", self.psd_asymmetry_um, 0.0..=500.0);
        at.number("psd_ripple_um", self.psd_ripple_um, 0.0..=100.0);
        at.numbers("psd_ripple_mm", &self.psd_ripple_mm, 0.5..=100.0);
        at.number("stage_turn_mrad", self.stage_turn_mrad, 0.0..=100.0);
        at.number("stage_lever_mm", self.stage_lever_mm, 0.0..=100.0);
        for (key, [least, largest]) in
            [("psd_bow_um", self.psd_bow_um), ("psd_ripple_mm", self.psd_ripple_mm)]
        {
            at.demand(
                least <= largest,
                key,
                format_args!("[{least}, {largest}]"),
                "the smaller number first",
            );
        }
    }
}

impl TwinTemperature {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("warm_up_k", self.warm_up_k, -50.0..=50.0);
        at.number("warm_up_s", self.warm_up_s, above_zero(1e6));
        at.number("swing_k", self.swing_k, -50.0..=50.0);
        at.number("swing_s", self.swing_s, above_zero(1e6));
        at.number("psd_zero_um_per_k", self.psd_zero_um_per_k, 0.0..=100.0);
        at.number("psd_gain_ppm_per_k", self.psd_gain_ppm_per_k, 0.0..=10_000.0);
        at.number("distance_ppm_per_k", self.distance_ppm_per_k, -1000.0..=1000.0);
        at.number("height_um_per_k", self.height_um_per_k, -100.0..=100.0);
        at.number("beam_tilt_urad_per_k", self.beam_tilt_urad_per_k, 0.0..=1000.0);
        at.number("channel_v_per_k", self.channel_v_per_k, -10.0..=10.0);
    }
}
