//! `[steering]`: the stage that moves the laser.

use serde::{Deserialize, Serialize};
use trifacet_core::centering::OnExit;

use super::check::{Checker, above_zero};
use super::gcs::GcsConfig;
use super::tilt::TiltConfig;

/// Kind of the stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", try_from = "String")]
pub enum SteeringKind {
    /// The two outputs of the board, or of the twin.
    Outputs,
    /// A PI stage whose controller uses the General Command Set 2.0.
    Gcs,
    /// A mirror that tilts the beam.
    Tilt,
}

/// Why tilting stages are refused by everything but `check`, `trace` and `solve`.
pub const NO_TILT: &str = "the loop steers a laser that is translated; a tilting mirror turns the beam \
                           (100 um over 1 m are 100 urad, which would appear as 12.5 um and 50 urad of pose); \
                           only the commands check, trace and solve compute with such a beam, with \
                           steering.kind = \"tilt\" and steering.tilt.pivot_mm";

/// Slow pointing of a laser without other information: 8 urad over 125 mm, micrometres.
pub const POINTING_UM: f64 = 1.0;

/// A kind of stage that does not exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("allowed is `outputs`, `gcs` or `tilt`")]
pub struct UnknownSteeringKind;

impl TryFrom<String> for SteeringKind {
    type Error = UnknownSteeringKind;

    fn try_from(name: String) -> Result<Self, UnknownSteeringKind> {
        match name.as_str() {
            "outputs" => Ok(Self::Outputs),
            "gcs" => Ok(Self::Gcs),
            "tilt" => Ok(Self::Tilt),
            _ => Err(UnknownSteeringKind),
        }
    }
}

/// Settings of `[steering]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SteeringConfig {
    /// Kind of the stage.
    pub kind: SteeringKind,
    /// Displacement of the beam perpendicular to its direction (rows: x, y) per displacement of each stage
    /// axis (columns).
    pub matrix: [[f64; 2]; 2],
    /// Position of the beam in the plane of the apex with the stage at zero, micrometres.
    pub origin_um: [f64; 2],
    /// Whether `origin_um` is known to be that of the laser. `tune --accept-origin` sets it to false.
    pub origin_verified: bool,
    /// Standard uncertainty of the readback itself, on each axis, micrometres.
    pub readback_um: f64,
    /// Slow pointing of the laser: standard uncertainty of the beam position at the apex, on each axis,
    /// micrometres. `None`: [`POINTING_UM`], or what [`deviation_um`](Self::deviation_um) leaves.
    pub pointing_um: Option<f64>,
    /// Both together, micrometres: the only key of earlier versions. It takes the place of both.
    pub deviation_um: Option<f64>,
    /// Position at the full-scale output code, micrometres.
    pub full_scale_um: f64,
    /// Limit of the command, plus and minus, micrometres.
    pub limit_um: f64,
    /// Limit of the velocity of the command, mm/s.
    pub slew_mm_per_s: f64,
    /// Parking position, micrometres.
    pub park_um: [f64; 2],
    /// Action when the daemon ends.
    pub on_exit: OnExit,
    /// Validity of a command, milliseconds.
    pub lease_ms: u16,
    /// Action of the board when the lease of a command expires.
    pub on_lease: OnExit,
    /// The controller of a PI stage.
    pub gcs: GcsConfig,
    /// A mirror that tilts the beam.
    pub tilt: TiltConfig,
}

impl Default for SteeringConfig {
    fn default() -> Self {
        Self {
            kind: SteeringKind::Outputs,
            matrix: [[1.0, 0.0], [0.0, 1.0]],
            origin_um: [0.0; 2],
            origin_verified: true,
            readback_um: 0.1,
            pointing_um: None,
            deviation_um: None,
            full_scale_um: 500.0,
            limit_um: 400.0,
            slew_mm_per_s: 50.0,
            park_um: [0.0; 2],
            on_exit: OnExit::Hold,
            lease_ms: 200,
            on_lease: OnExit::Hold,
            gcs: GcsConfig::default(),
            tilt: TiltConfig::default(),
        }
    }
}

impl SteeringConfig {
    /// Standard uncertainty of the beam position derived from the readback, on each axis, micrometres.
    /// Averaging does not reduce it.
    pub fn beam_sigma_um(&self) -> f64 {
        self.deviation_um.unwrap_or_else(|| self.readback_um.hypot(self.pointing_um.unwrap_or(POINTING_UM)))
    }

    /// The parts of [`beam_sigma_um`](Self::beam_sigma_um): readback and pointing, micrometres.
    pub fn beam_sigma_parts_um(&self) -> [f64; 2] {
        let whole = self.beam_sigma_um();
        let readback = self.readback_um.min(whole);
        [readback, (whole * whole - readback * readback).sqrt()]
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        self.check_matrix(&mut at);
        at.numbers("origin_um", &self.origin_um, -100_000.0..=100_000.0);
        at.number("readback_um", self.readback_um, above_zero(1000.0));
        at.optional("pointing_um", self.pointing_um, 0.0..=1000.0);
        at.optional("deviation_um", self.deviation_um, above_zero(1000.0));
        at.agree(
            self.deviation_um.is_none() || self.pointing_um.is_none(),
            "deviation_um",
            &["pointing_um"],
            format!("{:?}", self.deviation_um.unwrap_or_default()),
            "either steering.pointing_um, or steering.deviation_um, which includes readback and pointing",
        );
        at.number("full_scale_um", self.full_scale_um, 1.0..=100_000.0);
        at.number("limit_um", self.limit_um, 1.0..=100_000.0);
        at.number("slew_mm_per_s", self.slew_mm_per_s, above_zero(10_000.0));
        at.numbers("park_um", &self.park_um, -100_000.0..=100_000.0);
        at.number("lease_ms", self.lease_ms, 10.0..=10_000.0);
        at.agree(
            self.limit_um <= self.full_scale_um || self.kind != SteeringKind::Outputs,
            "limit_um",
            &["full_scale_um"],
            format!("{:?}", self.limit_um),
            format_args!("at most steering.full_scale_um, {}", self.full_scale_um),
        );
        for (i, park) in self.park_um.iter().enumerate() {
            at.agree(
                park.abs() <= self.limit_um,
                &format!("park_um[{i}]"),
                &["limit_um"],
                format!("{park:?}"),
                format_args!("within plus/minus steering.limit_um, {}", self.limit_um),
            );
        }
        at.agree(
            self.on_lease == OnExit::Hold || self.kind != SteeringKind::Gcs,
            "on_lease",
            &["kind"],
            "\"park\"",
            "\"hold\" with steering.kind = \"gcs\": the controller has no lease and holds its position when commands stop",
        );
        self.gcs.check(at.section("gcs"), self.kind == SteeringKind::Gcs);
        self.tilt.check(at.section("tilt"), self.kind == SteeringKind::Tilt);
    }

    /// The matrix describes two axes that move the beam in two different directions.
    fn check_matrix(&self, at: &mut Checker<'_>) {
        let [[a, b], [c, d]] = self.matrix;
        at.numbers("matrix[0]", &self.matrix[0], -100.0..=100.0);
        at.numbers("matrix[1]", &self.matrix[1], -100.0..=100.0);
        let size = a.hypot(c) * b.hypot(d);
        let independent = (a * d - b * c).abs() >= 0.1 * size && size >= 1e-6;
        let allowed = "columns that are neither zero nor nearly parallel: the axes must move the beam in two directions";
        at.demand(independent || size.is_nan(), "matrix", format!("{:?}", self.matrix), allowed);
    }
}

#[cfg(test)]
mod tests {
    use crate::config::parse;

    fn parts(text: &str) -> [f64; 2] {
        parse(text, None).unwrap().steering.beam_sigma_parts_um()
    }

    #[test]
    fn deviation_takes_the_place_of_readback_and_pointing() {
        let close = |[a, b]: [f64; 2], [c, d]: [f64; 2]| (a - c).abs() + (b - d).abs() < 1e-9;
        assert!(close(parts(""), [0.1, 1.0]));
        assert!(close(parts("steering = { readback_um = 0.3, pointing_um = 0 }"), [0.3, 0.0]));
        for (deviation, pointing) in [(1.5, (1.5_f64 * 1.5 - 0.01).sqrt()), (0.1, 0.0), (0.05, 0.0)] {
            let steering = parse(&format!("steering.deviation_um = {deviation}"), None).unwrap().steering;
            assert_eq!(steering.beam_sigma_um(), deviation);
            let [readback, rest] = steering.beam_sigma_parts_um();
            assert!(readback <= deviation && (rest - pointing).abs() < 1e-9, "{readback} {rest}");
        }
    }

    #[test]
    fn deviation_and_pointing_together_are_refused() {
        let error = parse("[steering]\npointing_um = 1\ndeviation_um = 1.5", None).unwrap_err().to_string();
        assert!(
            error.contains("steering.deviation_um = 1.5") && error.contains("steering.pointing_um"),
            "{error}"
        );
    }
}
