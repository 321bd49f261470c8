//! Checks whether the readback of the steering position agrees with the pose.

use serde::{Deserialize, Serialize};
use trifacet_optics::{BeamPosition, Innovation, Vec2};

use crate::steering::{BeamMap, StagePosition};

/// A residual, or the mean of many, of more than this many standard uncertainties does not fit. By chance one
/// in 270 000 does.
pub const LIMIT: f64 = 5.0;
/// After this many misfits in a row, the steering contradicts the pose. After this many fits, the readback
/// may be fused.
const ROW: u32 = 10;
/// Number of residuals in the running mean. A small error of the beam position disappears in the noise of
/// single residuals, but shows in the mean of this many. The fused pose would carry the error at many of its
/// standard uncertainties, because the readback makes these small.
const WINDOW: f64 = 100.0;
/// Nothing is fused while the mean exceeds this many of its standard uncertainties.
const MEAN_LIMIT: f64 = 3.0;

/// Map from the readback of the stage to the position of the beam, with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Readback {
    map: BeamMap,
    sigma: f64,
}

impl Default for Readback {
    fn default() -> Self {
        Self::new(BeamMap::default(), 0.1_f64.hypot(1.0) * 1e-6)
    }
}

impl Readback {
    /// The readback of a stage with this map. `sigma` is the standard uncertainty of the resulting beam
    /// position, metres on each axis.
    pub fn new(map: BeamMap, sigma: f64) -> Self {
        Self { map, sigma }
    }

    /// The beam position for a position of the stage, metres. Averaging does not reduce its standard
    /// uncertainty: drift of the laser direction does not average out.
    pub fn beam_position(&self, stage: [f64; 2]) -> BeamPosition {
        BeamPosition { at: self.map.beam(StagePosition(stage)).into(), sigma: self.sigma }
    }
}

/// The integrity check over successive reports. Reports without a residual do not count.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Integrity {
    /// Number of successive residuals that do not fit.
    misfits: u32,
    /// Mean of the residuals that fit, metres.
    mean: Vec2,
    count: f64,
}

impl Integrity {
    /// Takes a residual. Returns whether the beam position may be fused: the residual fits, the mean of the
    /// last ones fits, and there have been enough of them.
    pub fn judge(&mut self, innovation: &Innovation<'_>) -> bool {
        if !self.fits(innovation.normalized_residual()) {
            return false;
        }
        self.count = WINDOW.min(self.count + 1.0);
        self.mean += (innovation.residual - self.mean) / self.count;
        self.count >= f64::from(ROW) && innovation.normalized_mean(self.mean, self.count) <= MEAN_LIMIT
    }

    fn fits(&mut self, normalized_residual: f64) -> bool {
        let fits = normalized_residual <= LIMIT;
        self.misfits = if fits { 0 } else { self.misfits.saturating_add(1) };
        if self.inconsistent() {
            (self.mean, self.count) = (Vec2::zeros(), 0.0); // the mean starts again after a contradiction
        }
        fits
    }

    /// Whether steering and pose contradict each other.
    pub fn inconsistent(&self) -> bool {
        self.misfits >= ROW
    }
}

/// The mean residual over about a second, in a report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanResidual {
    /// The mean: readback minus nine signals, x and y across the beam, metres.
    pub mean: [f64; 2],
    /// Length in this direction beyond which the mean contradicts the pose, metres.
    pub limit: f64,
    /// The mean has exceeded its limit, and has not returned below four fifths of it.
    pub contradicts: bool,
}

/// The slow part of the integrity check: a constant error of the beam position is far below the noise of one
/// residual, but the noise of a mean shrinks. A residual beyond its own limit counts as one at the limit, so that
/// outliers do not linger.
///
/// The mean is an exponential one. Its noise is that of a plain mean over twice its time constant, and it is
/// judged when it has this many residuals.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct SlowResidual {
    mean: Vec2,
    count: f64,
    contradicts: bool,
}

impl SlowResidual {
    /// Time constant, seconds.
    const TIME_S: f64 = 0.5;
    /// Fewest reports in a time constant.
    const LEAST: f64 = 5.0;
    /// A contradiction ends below this many standard uncertainties.
    const AGAIN: f64 = 4.0;

    /// Time constant in reports, for this many reports per second. The mean has the noise of twice as many, less one.
    pub fn window(reports_per_s: f64) -> f64 {
        (Self::TIME_S * reports_per_s).max(Self::LEAST)
    }

    /// Takes a residual.
    pub fn push(&mut self, innovation: &Innovation<'_>, window: f64) -> Option<MeanResidual> {
        let whole = 2.0 * window - 1.0;
        let beyond = (innovation.normalized_residual() / LIMIT).max(1.0);
        self.count = whole.min(self.count + 1.0);
        self.mean += (innovation.residual / beyond - self.mean) / self.count.min(window);
        if self.count < whole {
            return None;
        }
        let sigma = innovation.mean_sigma(self.mean, whole)?;
        let allowed = sigma * if self.contradicts { Self::AGAIN } else { LIMIT };
        self.contradicts = self.mean.norm() > allowed;
        Some(MeanResidual { mean: self.mean.into(), limit: LIMIT * sigma, contradicts: self.contradicts })
    }

    /// Whether the mean contradicts the pose.
    pub fn contradicts(&self) -> bool {
        self.contradicts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::steering::BeamPoint;

    #[test]
    fn ten_contradictions_in_sequence_are_reported_and_one_agreement_ends_the_report() {
        let mut integrity = Integrity::default();
        let mut seen = |normalized_residual: f64, times: usize| {
            (0..times)
                .map(|_| (integrity.fits(normalized_residual), integrity.inconsistent()))
                .last()
                .unwrap()
        };
        assert_eq!(seen(5.1, 9), (false, false));
        assert_eq!(seen(4.9, 1), (true, false));
        assert_eq!(seen(f64::NAN, 9), (false, false));
        assert_eq!(seen(1e9, 1), (false, true));
        assert_eq!(seen(5.0, 1), (true, false));
    }

    #[test]
    fn a_rotated_stage_gives_the_beam_position() {
        let map = BeamMap::new([[0.0, -2.0], [0.5, 0.0]], BeamPoint([10e-6, 20e-6]));
        let beam_position = Readback::new(map, 1.5e-6).beam_position([100e-6, 30e-6]);
        assert!((beam_position.at - Vec2::new(-50e-6, 70e-6)).norm() < 1e-18, "{beam_position:?}");
        assert_eq!(beam_position.sigma, 1.5e-6);
    }
}
