//! Whether the steering follows its readback as well as stated: a drift of the laser's direction shows here first.

use super::point::Point;

/// The residual of the steering counts as more than stated beyond this factor.
const EXCESS: f64 = 3.0;
/// Fewest points that tell.
const FEWEST: usize = 20;
/// Standard deviation of normal numbers whose absolute value has the median 1.
const BY_MEDIAN: f64 = 1.4826;

/// A residual of the steering that is larger than stated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pointing {
    /// Standard deviation of the residual along the worse axis, from its median: metres.
    pub residual: f64,
    /// Standard uncertainty of the readback that the points state, median: metres.
    pub stated: f64,
}

impl Pointing {
    /// Judges the residuals of the points, x and y in metres; `None` if noise of the readings and of the readback
    /// explains them, or if there are too few.
    pub(super) fn judge(points: &[Point], residuals: &[Option<[f64; 2]>]) -> Option<Self> {
        let used: Vec<_> = points
            .iter()
            .zip(residuals)
            .filter_map(|(point, residual)| Some((point, point.steering?, (*residual)?)))
            .collect();
        if used.len() < FEWEST {
            return None;
        }
        let judged = [0, 1].map(|axis| {
            let residual = BY_MEDIAN * median(used.iter().map(|(_, _, r)| r[axis].abs()));
            let stated = median(used.iter().map(|(_, known, _)| known[axis].deviation));
            Self { residual, stated }
        });
        let readings =
            median(used.iter().map(|(point, ..)| point.spot_deviations.into_iter().fold(0.0, f64::max)));
        let worst = judged.into_iter().max_by(|a, b| a.residual.total_cmp(&b.residual))?;
        (worst.residual > EXCESS * worst.stated.hypot(readings)).then_some(worst)
    }
}

/// The middle one of numbers; there is at least one.
fn median(numbers: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = numbers.collect();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}
