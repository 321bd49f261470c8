//! The drift of a head since its calibration: the mean steering residual against that of the calibration. Pure.
//!
//! The residual shows a laser that points elsewhere, a PSD or a mirror that is displaced, gains of the PSDs that
//! changed. It does not tell these apart: a change of the power gains moves the balanced beam, as pointing does.

use trifacet_optics::Vec2;
use trifacet_wire::{LockState, Status};

use crate::estimation::PoseReport;
use crate::estimation::integrity::LIMIT;
use crate::time::{Mono, NS_PER_S};

/// The drift is doubted beyond this many combined standard uncertainties. It is not a matter of noise, of which the slow
/// mean has little.
const COVERAGE: f64 = 3.0;
/// A doubt ends below this part of the limit.
const AGAIN: f64 = 0.8;
/// One mean residual in this time counts: it is a mean over about as long. Nanoseconds.
const INTERVAL: i64 = NS_PER_S;
/// Time constant of the slow mean, in intervals.
const WINDOW: f64 = 10.0;

/// The steering residual at the calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualReference {
    /// Its mean: readback minus nine signals, x and y across the beam, metres.
    pub mean: [f64; 2],
    /// Standard uncertainty by the calibration of what the residual must be, on each axis, metres.
    pub sigma: f64,
}

/// The slow mean of the residual, against the calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualDrift {
    /// Its difference from that of the calibration, metres.
    pub difference: [f64; 2],
    /// Length beyond which the difference is doubted, metres: three standard uncertainties of the calibration, the
    /// readback, the pointing and the noise together.
    pub limit: f64,
    /// The difference has exceeded the limit, and has not returned below four fifths of it.
    pub doubted: bool,
}

/// Follows the mean residual of successive reports.
#[derive(Clone, Copy, Debug)]
pub struct DriftCheck {
    reference: ResidualReference,
    mean: Vec2,
    count: f64,
    next: Option<Mono>,
    doubted: bool,
}

impl DriftCheck {
    /// Against this reference.
    pub fn new(reference: ResidualReference) -> Self {
        Self { reference, mean: Vec2::zeros(), count: 0.0, next: None, doubted: false }
    }

    /// Takes a report; returns a result about once per second. Only reports of a locked loop with all spots among the
    /// readings of the calibration count: elsewhere the calibration does not state what the residual must be.
    pub fn push(&mut self, report: &PoseReport) -> Option<ResidualDrift> {
        let counts = report.lock == LockState::Locked && !report.status.has(Status::OUT_OF_CALIBRATION);
        let residual = report.mean_residual.filter(|_| counts)?;
        if self.next.is_some_and(|next| report.time < next) {
            return None;
        }
        self.next = Some(report.time + INTERVAL);
        self.count = WINDOW.min(self.count + 1.0);
        self.mean += (Vec2::from(residual.mean) - self.mean) / self.count;
        let difference = self.mean - Vec2::from(self.reference.mean);
        let limit = COVERAGE * (residual.limit / LIMIT).hypot(self.reference.sigma);
        self.doubted = difference.norm() > limit * if self.doubted { AGAIN } else { 1.0 };
        Some(ResidualDrift { difference: difference.into(), limit, doubted: self.doubted })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::integrity::MeanResidual;

    /// A report in this second, with this mean residual along x and a standard uncertainty of 0.4 um.
    fn report(second: i64, x: f64) -> PoseReport {
        let mean_residual = Some(MeanResidual { mean: [x, 0.0], limit: 2e-6, contradicts: false });
        PoseReport { time: Mono(second * NS_PER_S), mean_residual, ..PoseReport::example() }
    }

    fn check() -> DriftCheck {
        DriftCheck::new(ResidualReference { mean: [0.1e-6, 0.0], sigma: 0.3e-6 })
    }

    /// 3 * hypot(0.4, 0.3) um.
    const LIMIT_UM: f64 = 1.5;

    #[test]
    fn a_drift_is_doubted_beyond_three_combined_uncertainties_until_it_is_clearly_within() {
        let mut check = check();
        let mut at = 0;
        let mut settled = |x: f64| {
            let mut last = None;
            for _ in 0..100 {
                at += 1;
                last = check.push(&report(at, x));
            }
            last.unwrap()
        };
        let first = settled(1.5e-6);
        assert!((first.limit - LIMIT_UM * 1e-6).abs() < 1e-15 && !first.doubted, "{first:?}");
        assert!((first.difference[0] - 1.4e-6).abs() < 1e-10 && first.difference[1] == 0.0);
        let doubted = [1.7e-6, 1.4e-6, 1.2e-6, -1.3e-6, -1.5e-6].map(|x| settled(x).doubted);
        assert_eq!(doubted, [true, true, false, false, true]);
    }

    #[test]
    fn a_large_drift_is_named_within_seconds_and_a_short_disturbance_is_not() {
        let mut check = check();
        (0..60).for_each(|second| _ = check.push(&report(second, 0.0)));
        assert!(!check.push(&report(60, 5e-6)).unwrap().doubted);
        let after: Vec<bool> =
            (61..67).map(|second| check.push(&report(second, 5e-6)).unwrap().doubted).collect();
        assert_eq!(after, [false, false, true, true, true, true]);
    }

    #[test]
    fn reports_that_the_calibration_says_nothing_about_do_not_count() {
        let mut check = check();
        let uncovered = Status::POSE_VALID | Status::OUT_OF_CALIBRATION;
        for unusable in [
            PoseReport { lock: LockState::Acquiring, ..report(1, 9e-6) },
            PoseReport { status: uncovered, ..report(1, 9e-6) },
            PoseReport { mean_residual: None, ..report(1, 9e-6) },
        ] {
            assert_eq!(check.push(&unusable), None);
        }
        assert!(check.push(&report(1, 9e-6)).unwrap().doubted);
        assert_eq!(check.push(&PoseReport { time: Mono(NS_PER_S + 1), ..report(1, 9e-6) }), None, "too soon");
    }
}
