//! `[twin]`: the digital twin of optics, stage and converter.

use serde::{Deserialize, Deserializer, Serialize, de};

use super::check::{Checker, above_zero};
use super::fault::Fault;
use super::head::HeadConfig;
use super::motion::{Axis, Motion, MotionKind};
use super::text::or_off;
use super::twin_head::{TwinBeam, TwinPsds, TwinStage, TwinTemperature, TwinTolerances};

/// Settings of `[twin]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinConfig {
    /// Seed of the random numbers: the same seed gives the same samples.
    pub seed: u64,
    /// Radius of the mirror, millimetres. Light outside it is lost.
    pub mirror_radius_mm: f64,
    /// Power of the laser, milliwatts.
    pub laser_mw: f64,
    /// Position of the beam at rest, world x and y, before steering, micrometres.
    pub laser_offset_um: [f64; 2],
    /// Slow pointing of the laser: standard deviation of the beam position at the apex on each axis, which the
    /// readback does not show, micrometres.
    pub pointing_um: f64,
    /// Correlation time of this drift, seconds.
    pub pointing_s: f64,
    /// Standard deviation of the noise of each spot coordinate, micrometres.
    pub spot_noise_um: f64,
    /// Relative standard deviation of the noise of each power.
    pub power_noise: f64,
    /// Resolution of the converter, bits.
    pub converter_bits: u8,
    /// Range of the converter, plus and minus, volts.
    pub converter_range_v: f64,
    /// Readings of the nine channels without light, volts: u, v, sum of A, of B, of C.
    pub dark_v: [f64; 9],
    /// Time from one channel of the converter to the next, microseconds.
    pub channel_skew_us: f64,
    /// Bow of the PSDs: error of the reading at the middle of an edge, micrometres.
    pub bow_um: f64,
    /// The true geometry; `None`: that of `[head]`, unless another of these sections gives the twin a head of its own.
    pub head: Option<HeadConfig>,
    /// The true PSDs. `None`: their gains are those of `[channels]`, unless the twin has a head of its own.
    pub psd: Option<TwinPsds>,
    /// The true shape of the beam. `None`: round.
    pub beam: Option<TwinBeam>,
    /// The stage that carries the mirror. `None`: its axes are those of the head, its origin is the apex.
    pub stage: Option<TwinStage>,
    /// Random errors of the head. `None`: none.
    pub tolerances: Option<TwinTolerances>,
    /// The temperature of the head. `None`: constant.
    pub temperature: Option<TwinTemperature>,
    /// The steering stage.
    pub steering: TwinSteering,
    /// Movements of the mirror. They are added.
    pub motion: Vec<Motion>,
    /// Simulated faults.
    pub fault: Vec<Fault>,
}

/// Settings of `[twin.steering]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinSteering {
    /// True displacement of the beam in x and y (rows) per displacement of each stage axis (columns).
    pub matrix: [[f64; 2]; 2],
    /// Time from a command to the start of the movement, milliseconds.
    pub delay_ms: f64,
    /// Time constant of the movement, milliseconds.
    pub lag_ms: f64,
    /// Mechanical limits, plus and minus, micrometres.
    pub limit_um: f64,
    /// Standard deviation of the noise of the readback, micrometres. `None` (`"off"` in the file): no
    /// readback channels.
    #[serde(deserialize_with = "number_or_off", serialize_with = "or_off")]
    pub readback_noise_um: Option<f64>,
}

impl Default for TwinConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            mirror_radius_mm: 5.0,
            laser_mw: 0.6,
            laser_offset_um: [0.0; 2],
            pointing_um: 0.0,
            pointing_s: 60.0,
            spot_noise_um: 1.08,
            power_noise: 1e-3,
            converter_bits: 18,
            converter_range_v: 10.0,
            dark_v: [0.0; 9],
            channel_skew_us: 0.0,
            bow_um: 0.0,
            head: None,
            psd: None,
            beam: None,
            stage: None,
            tolerances: None,
            temperature: None,
            steering: TwinSteering::default(),
            motion: demo_motion(),
            fault: Vec::new(),
        }
    }
}

impl Default for TwinSteering {
    fn default() -> Self {
        Self {
            matrix: [[1.0, 0.0], [0.0, 1.0]],
            delay_ms: 1.0,
            lag_ms: 0.5,
            limit_um: 500.0,
            readback_noise_um: Some(0.1),
        }
    }
}

/// The default motion: slow sines of some tens of micrometres and microradians on every axis.
fn demo_motion() -> Vec<Motion> {
    let wander = [
        (Axis::Tx, 40.0, 0.11),
        (Axis::Ty, 30.0, 0.07),
        (Axis::Tz, 20.0, 0.05),
        (Axis::Roll, 60.0, 0.09),
        (Axis::Pitch, 50.0, 0.13),
        (Axis::Yaw, 80.0, 0.04),
    ];
    wander
        .into_iter()
        .map(|(axis, amount, frequency_hz)| Motion {
            axis,
            amount_um: (!axis.is_turn()).then_some(amount),
            amount_urad: axis.is_turn().then_some(amount),
            kind: MotionKind::Sine,
            from_s: 0.0,
            until_s: None,
            frequency_hz: Some(frequency_hz),
            high_hz: None,
            phase_deg: 0.0,
        })
        .collect()
}

impl TwinConfig {
    /// Number of channels of a scan: nine signals, two readbacks if the stage has them, and a temperature.
    pub fn channel_count(&self) -> usize {
        let readbacks = if self.steering.readback_noise_um.is_some() { 2 } else { 0 };
        9 + readbacks + usize::from(self.temperature.is_some())
    }

    /// Whether the head of the twin is not the one that the estimator believes.
    pub fn has_own_head(&self) -> bool {
        self.head.is_some()
            || self.psd.is_some()
            || self.beam.is_some()
            || self.stage.is_some()
            || self.tolerances.is_some()
    }

    pub(super) fn check(&self, mut at: Checker<'_>, rate_hz: f64) {
        // The integers that a double represents exactly.
        at.number("seed", self.seed as f64, 0.0..=9_007_199_254_740_992.0);
        at.number("mirror_radius_mm", self.mirror_radius_mm, 0.01..=1000.0);
        at.number("laser_mw", self.laser_mw, 0.0..=1e6);
        at.numbers("laser_offset_um", &self.laser_offset_um, -100_000.0..=100_000.0);
        at.number("pointing_um", self.pointing_um, 0.0..=1000.0);
        at.number("pointing_s", self.pointing_s, 0.001..=1e6);
        at.number("spot_noise_um", self.spot_noise_um, 0.0..=1000.0);
        at.number("power_noise", self.power_noise, 0.0..=1.0);
        at.number("converter_bits", self.converter_bits, 8.0..=24.0);
        at.number("converter_range_v", self.converter_range_v, above_zero(100.0));
        at.numbers("dark_v", &self.dark_v, -100.0..=100.0);
        at.number("channel_skew_us", self.channel_skew_us, 0.0..=100_000.0);
        at.number("bow_um", self.bow_um, -1000.0..=1000.0);
        self.head.clone().unwrap_or_default().check(at.section("head"));
        self.psd.clone().unwrap_or_default().check(at.section("psd"));
        self.beam.clone().unwrap_or_default().check(at.section("beam"));
        self.stage.clone().unwrap_or_default().check(at.section("stage"));
        self.tolerances.clone().unwrap_or_default().check(at.section("tolerances"));
        self.temperature.clone().unwrap_or_default().check(at.section("temperature"));
        self.steering.check(at.section("steering"));
        for (i, motion) in self.motion.iter().enumerate() {
            motion.check(at.section(&format!("motion[{i}]")), rate_hz);
        }
        for (i, fault) in self.fault.iter().enumerate() {
            fault.check(at.section(&format!("fault[{i}]")));
        }
    }
}

impl TwinSteering {
    fn check(&self, mut at: Checker<'_>) {
        at.numbers("matrix[0]", &self.matrix[0], -100.0..=100.0);
        at.numbers("matrix[1]", &self.matrix[1], -100.0..=100.0);
        at.number("delay_ms", self.delay_ms, 0.0..=10_000.0);
        at.number("lag_ms", self.lag_ms, 0.0..=10_000.0);
        at.number("limit_um", self.limit_um, above_zero(100_000.0));
        at.optional("readback_noise_um", self.readback_noise_um, 0.0..=1000.0);
    }
}

fn number_or_off<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    struct NumberOrOff;
    impl de::Visitor<'_> for NumberOrOff {
        type Value = Option<f64>;
        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("a number, or \"off\"")
        }
        fn visit_f64<E: de::Error>(self, number: f64) -> Result<Option<f64>, E> {
            Ok(Some(number))
        }
        fn visit_i64<E: de::Error>(self, number: i64) -> Result<Option<f64>, E> {
            Ok(Some(number as f64))
        }
        fn visit_str<E: de::Error>(self, text: &str) -> Result<Option<f64>, E> {
            let other = || E::invalid_value(de::Unexpected::Str(text), &self);
            if text == "off" { Ok(None) } else { Err(other()) }
        }
    }
    from.deserialize_any(NumberOrOff)
}
