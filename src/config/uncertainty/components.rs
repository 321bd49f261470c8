//! The input quantities of the budget, from the configuration. SI units.

use std::fmt;

use trifacet_budget::{Distribution, Evaluation, Input};
use trifacet_core::channels::Amplifier;
use trifacet_core::uncertainty::{Effect, Moment};
use trifacet_optics::{FACETS, Rigid};

use super::quantity::{Group, Unit};
use crate::config::{Config, Model, SourceKind};

/// An effect that the budget does not cover.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotCovered {
    /// The effect.
    pub what: String,
    /// The key that would state it.
    pub key: &'static str,
}

impl fmt::Display for NotCovered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({} is not set)", self.what, self.key)
    }
}

/// The quantities of an instrument.
#[derive(Clone, Debug, Default)]
pub struct Components {
    /// The rows of the table, without the calibration.
    pub groups: Vec<Group>,
    /// What the configuration does not state.
    pub not_covered: Vec<NotCovered>,
    /// Effects that do not matter here, and why.
    pub notes: Vec<String>,
}

const SPOTS: [&str; 6] = ["u of A", "v of A", "u of B", "v of B", "u of C", "v of C"];
const XY: [&str; 2] = ["x", "y"];
const XYZ: [&str; 3] = ["x", "y", "z"];
const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];
const PAIRS: [&str; 3] = ["xy", "xz", "yz"];

impl Components {
    /// The quantities that a configuration states, for poses that are means of `average` samples. `table`: that of
    /// the reference of the calibration, in the frame of the mirror, if a record states the share of geometry and
    /// correction tables.
    pub fn new(config: &Config, average: u32, table: Option<&Rigid>) -> Self {
        let mut all = Self::default();
        all.noise(config, average);
        all.converter(config);
        all.systematic(config, table.is_some());
        if table.is_none() {
            all.residue(config);
        }
        all.light(config);
        all.temperature(config);
        all.reference(config);
        all.lever_arm(config, table);
        all.dark(config);
        if config.estimation.fuse_steering {
            all.notes.push(
                "the budget is that of nine signals: with estimation.fuse_steering the noise is lower".into(),
            );
        }
        all
    }

    /// What averaging does not reduce and what depends on the pose: standard uncertainties, and what they act on.
    /// `tared`: poses are relative to a tare, whose readings were noisy.
    pub fn by_pose(&self, tared: bool) -> Vec<(f64, Effect)> {
        let counts = |input: &Input, effect: Effect| match effect {
            Effect::Spot(Moment::Pose, _) | Effect::Power(Moment::Pose, _) => {
                input.evaluation == Evaluation::B
            }
            Effect::Spot(Moment::Tare, _)
            | Effect::Power(Moment::Tare, _)
            | Effect::Offset(Moment::Tare, _) => tared,
            Effect::Pose(_) => false, // the same at every pose, see `Settings::systematic`
            _ => true,
        };
        let inputs = self.groups.iter().flat_map(|group| &group.inputs);
        inputs.filter(|(input, effect)| counts(input, *effect)).map(|(i, e)| (i.std, *e)).collect()
    }

    /// A row of normally distributed quantities with these names; none if they have no uncertainty.
    fn row(&mut self, name: &str, source: &str, unit: Unit, std: f64, parts: &[(&str, Effect)]) {
        self.shaped(name, source, unit, std, Distribution::Normal, parts);
    }

    fn shaped(
        &mut self,
        name: &str,
        source: &str,
        unit: Unit,
        std: f64,
        distribution: Distribution,
        parts: &[(&str, Effect)],
    ) {
        if std > 0.0 {
            let input = |(part, effect): &(&str, Effect)| {
                let name = if part.is_empty() { name.to_owned() } else { format!("{name}: {part}") };
                (Input::new(name, 0.0, std, distribution), *effect)
            };
            let inputs = parts.iter().map(input).collect();
            self.groups.push(Group { name: name.into(), source: source.into(), unit, inputs });
        }
    }

    fn lacks(&mut self, what: &str, key: &'static str) {
        self.not_covered.push(NotCovered { what: what.into(), key });
    }

    fn noise(&mut self, config: &Config, average: u32) {
        let (estimation, dof) = (&config.estimation, config.uncertainty.noise_dof);
        for (moment, readings, when) in
            [(Moment::Pose, average, "pose"), (Moment::Tare, config.uncertainty.tare_readings, "tare")]
        {
            let mean = f64::from(readings).sqrt();
            let spots = SPOTS
                .iter()
                .enumerate()
                .map(|(i, name)| (*name, Effect::Spot(moment, i)))
                .collect::<Vec<_>>();
            let (name, source) =
                (format!("spot noise, {when}"), format!("estimation.spot_noise_um, mean of {readings}"));
            self.row(&name, &source, Unit::Metre, estimation.spot_noise_um * 1e-6 / mean, &spots);
            if estimation.model == Model::Gaussian {
                let names = FACETS.map(|facet| facet.to_string());
                let powers: Vec<_> = (0..3).map(|i| (names[i].as_str(), Effect::Power(moment, i))).collect();
                let (name, source) =
                    (format!("power noise, {when}"), format!("estimation.power_noise, mean of {readings}"));
                self.row(&name, &source, Unit::One, estimation.power_noise / mean, &powers);
            }
        }
        for (input, _) in self.groups.iter_mut().flat_map(|group| &mut group.inputs) {
            *input = input.clone().evaluated(Evaluation::A, dof.unwrap_or(f64::INFINITY));
            if dof.is_some() {
                input.distribution = Distribution::StudentT;
            }
        }
    }

    /// The rounding of each coordinate to a step of the converter.
    fn converter(&mut self, config: &Config) {
        let twin = (config.acquisition.source == SourceKind::Twin).then_some(&config.twin);
        let bits = config.uncertainty.converter_bits.or(twin.map(|t| t.converter_bits));
        let range = config.uncertainty.converter_range_v.or(twin.map(|t| t.converter_range_v));
        let (Some(bits), Some(range)) = (bits, range) else {
            self.lacks("resolution of the converter", "uncertainty.converter_bits or converter_range_v");
            return;
        };
        let step_v = 2.0 * range / 2.0_f64.powi(i32::from(bits));
        let half_size = config.head.psd_size_mm * 0.5e-3;
        // Metres per volt, of the least sensitive PSD.
        let mut scale = 0.0_f64;
        for psd in config.channels.psds() {
            let full = match psd.amplifier {
                Amplifier::Normalised => Some(psd.full_scale_v),
                Amplifier::Difference => sum_v(config),
            };
            let Some(full) = full else {
                self.lacks("resolution of the converter with a difference amplifier", "laser.power_uw");
                return;
            };
            scale = psd.gain[..2].iter().fold(scale, |most, gain| most.max(gain.abs() * half_size / full));
        }
        let half = 0.5 * step_v * scale;
        for (moment, when) in [(Moment::Pose, "pose"), (Moment::Tare, "tare")] {
            let spots: Vec<_> =
                SPOTS.iter().enumerate().map(|(i, name)| (*name, Effect::Spot(moment, i))).collect();
            let (name, source) =
                (format!("converter, {when}"), format!("a step of {bits} bits over +-{range} V"));
            let std = half / 3.0_f64.sqrt();
            self.shaped(&name, &source, Unit::Metre, std, Distribution::Rectangular, &spots);
        }
    }

    /// What stands for the errors of the head's geometry.
    fn systematic(&mut self, config: &Config, recorded: bool) {
        let systematic = config.systematic(recorded);
        if systematic != config.estimation.systematic() {
            let why = "the calibration record states the uncertainty of the geometry";
            self.notes.push(format!("estimation.systematic_um and systematic_urad do not count: {why}"));
        }
        for (name, key, unit, axes, from) in [
            ("systematic, position", "estimation.systematic_um", Unit::Metre, XYZ, 0),
            ("systematic, rotation", "estimation.systematic_urad", Unit::Radian, ANGLES, 3),
        ] {
            let mut inputs = Vec::new();
            for (i, axis) in axes.iter().enumerate().filter(|(i, _)| systematic[from + i] > 0.0) {
                let input = Input::normal(format!("{name}: {axis}"), 0.0, systematic[from + i]);
                inputs.push((input, Effect::Pose(from + i)));
            }
            if !inputs.is_empty() {
                self.groups.push(Group { name: name.into(), source: key.into(), unit, inputs });
            }
        }
    }

    /// What correction tables leave. A calibration record contains it.
    fn residue(&mut self, config: &Config) {
        if config.channels.psds().iter().all(|psd| psd.correction.is_some()) {
            let spots: Vec<_> =
                SPOTS.iter().enumerate().map(|(i, name)| (*name, Effect::Spot(Moment::Pose, i))).collect();
            let std = config.uncertainty.map_residue_um * 1e-6;
            self.row("residue of the PSD maps", "uncertainty.map_residue_um", Unit::Metre, std, &spots);
        }
    }

    fn light(&mut self, config: &Config) {
        let stated = &config.uncertainty;
        match stated.pointing_urad {
            Some(urad) => self.row(
                "beam direction since the tare",
                "uncertainty.pointing_urad",
                Unit::Radian,
                urad * 1e-6,
                &[("about x", Effect::Direction(0)), ("about y", Effect::Direction(1))],
            ),
            None => self.lacks("direction of the beam since the tare", "uncertainty.pointing_urad"),
        }
        if config.estimation.model == Model::Gaussian {
            let (offset_um, from) = match stated.beam_offset_um {
                Some(um) => (um, "uncertainty.beam_offset_um"),
                None => (config.centering.lock_limit_um, "centering.lock_limit_um"),
            };
            let std = offset_um * 1e-6 * stated.diameter_percent * 1e-2;
            for (moment, when) in [(Moment::Pose, "pose"), (Moment::Tare, "tare")] {
                let parts: Vec<_> =
                    XY.iter().enumerate().map(|(i, name)| (*name, Effect::Offset(moment, i))).collect();
                let source = format!("uncertainty.diameter_percent times {from}");
                self.row(&format!("beam offset by diameter, {when}"), &source, Unit::Metre, std, &parts);
            }
        }
    }

    /// Drift with the temperature, which cycles between its limits: arc sine distributions.
    fn temperature(&mut self, config: &Config) {
        let stated = &config.uncertainty;
        let Some(range) = stated.temperature_range_k else {
            self.lacks("drift with the temperature since the tare", "uncertainty.temperature_range_k");
            return;
        };
        let kelvins = range / 2.0_f64.sqrt();
        let side = config.head.psd_size_mm * 1e-3;
        let spots: Vec<_> =
            SPOTS.iter().enumerate().map(|(i, name)| (*name, Effect::Spot(Moment::Pose, i))).collect();
        let mut drift = |name: &str, key: &str, unit, std: f64, parts: &[(&str, Effect)]| {
            let source = format!("{key}, +-{range} K");
            self.shaped(name, &source, unit, std, Distribution::Arcsine, parts);
        };
        let zero = stated.psd_zero_ppm_per_k * 1e-6 * side * kelvins;
        drift("PSD zero drift", "uncertainty.psd_zero_ppm_per_k", Unit::Metre, zero, &spots);
        let gain = stated.psd_gain_ppm_per_k * 1e-6 * kelvins;
        drift("PSD gain drift", "uncertainty.psd_gain_ppm_per_k", Unit::One, gain, &[("", Effect::Gain)]);
        let distance = stated.psd_distance_ppm_per_k * 1e-6 * kelvins;
        let key = "uncertainty.psd_distance_ppm_per_k";
        drift("PSD distance drift", key, Unit::One, distance, &[("", Effect::Distance)]);
        if let Some(mm) = stated.height_difference_mm {
            let height = stated.height_ppm_per_k * 1e-6 * mm * 1e-3 * kelvins;
            let key = "uncertainty.height_ppm_per_k over height_difference_mm";
            drift("height drift", key, Unit::Metre, height, &[("", Effect::Height)]);
        } else {
            self.lacks(
                "drift of the height of the PSDs against the mirror",
                "uncertainty.height_difference_mm",
            );
        }
    }

    fn reference(&mut self, config: &Config) {
        let stated = &config.uncertainty;
        let scale: Vec<_> = XYZ.iter().enumerate().map(|(i, name)| (*name, Effect::Scale(i))).collect();
        let angle: Vec<_> =
            ANGLES.iter().enumerate().map(|(i, name)| (*name, Effect::AngleScale(i))).collect();
        let square: Vec<_> =
            PAIRS.iter().enumerate().map(|(i, name)| (*name, Effect::Squareness(i))).collect();
        for (name, what, key, value, unit, parts) in [
            (
                "reference scale",
                "scale of the reference",
                "uncertainty.reference_scale_ppm",
                stated.reference_scale_ppm,
                Unit::One,
                scale,
            ),
            (
                "reference angle scale",
                "scale of the angles of the reference",
                "uncertainty.reference_angle_ppm",
                stated.reference_angle_ppm,
                Unit::One,
                angle,
            ),
            (
                "reference squareness",
                "squareness of the reference",
                "uncertainty.reference_squareness_urad",
                stated.reference_squareness_urad,
                Unit::Radian,
                square,
            ),
        ] {
            match value {
                Some(millionths) => self.row(name, key, unit, millionths * 1e-6, &parts),
                None => self.lacks(what, key),
            }
        }
    }

    fn lever_arm(&mut self, config: &Config, table: Option<&Rigid>) {
        let key = "uncertainty.lever_arm_um";
        let parts: Vec<_> = XYZ.iter().enumerate().map(|(i, name)| (*name, Effect::Tool(i))).collect();
        match config.uncertainty.lever_arm_um {
            Some(um) => self.row("lever arm", key, Unit::Metre, um * 1e-6, &parts),
            None if config.frames.tool.translation_mm == [0.0; 3] => {
                self.notes.push("the poses are those of the apex: there is no lever arm".into());
            }
            // The calibration found frames.tool, and its covariance is that of poses at this point.
            None if table.is_some_and(|table| same_point(table, &config.frames.tool.build())) => {
                self.notes.push("the calibration covers the lever arm of frames.tool".into());
            }
            None => self.lacks("lever arm of frames.tool", key),
        }
    }

    /// A dark offset of the sum scales the coordinates of a difference amplifier. Those of a normalised amplifier
    /// move by a constant, which the tare takes off.
    fn dark(&mut self, config: &Config) {
        let key = "uncertainty.dark_mv";
        let psds = config.channels.psds();
        let names = FACETS.map(|facet| facet.to_string());
        let parts: Vec<_> = (0..3)
            .filter(|i| psds[*i].amplifier == Amplifier::Difference)
            .map(|i| (names[i].as_str(), Effect::SumOffset(i)))
            .collect();
        if parts.is_empty() {
            self.notes.push("normalised amplifiers: the tare takes dark offsets off".into());
            return;
        }
        match (config.uncertainty.dark_mv, sum_v(config)) {
            (None, _) => self.lacks("dark offset of the sums", key),
            (_, None) => self.lacks("dark offset of the sums", "laser.power_uw"),
            (Some(mv), Some(sum)) => {
                self.row("dark offset of the sum", key, Unit::One, mv * 1e-3 / sum, &parts);
            }
        }
    }
}

/// Whether the origins are less than a micrometre apart.
fn same_point(a: &Rigid, b: &Rigid) -> bool {
    (a.translation - b.translation).norm() < 1e-6
}

/// The sum signal of a PSD that receives a third of the light, volts.
fn sum_v(config: &Config) -> Option<f64> {
    let mw = config.laser.power_uw? * 1e-3;
    Some(mw / 3.0 / config.channels.power_mw_per_v)
}
