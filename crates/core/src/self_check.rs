//! Evaluation of a self-check: does the pose depend on where the beam meets the mirror? Pure.
//!
//! The mirror rests while the beam is moved over a small pattern. The pose must not change, and the offset must
//! change as much as the beam position by the readback. Both are fitted as linear functions of the beam position,
//! with a steady drift.

use nalgebra::{Matrix4, SMatrix, SVector};

/// Quantities of a point: tx, ty, tz (m), roll, pitch, yaw (rad), offset x and y (m).
pub const QUANTITIES: usize = 8;
/// Names of the quantities, with the units of their dependence on the beam position.
pub const NAMES: [(&str, &str); QUANTITIES] = [
    ("tx", "um/um"),
    ("ty", "um/um"),
    ("tz", "um/um"),
    ("roll", "urad/um"),
    ("pitch", "urad/um"),
    ("yaw", "urad/um"),
    ("offset x", "um/um"),
    ("offset y", "um/um"),
];
/// A dependence below this is not reported: `matrix` is not known better. Per metre of beam.
const FLOOR: [f64; QUANTITIES] = [0.02, 0.02, 0.02, 0.04, 0.04, 0.04, 0.02, 0.02];
/// A dependence must also exceed this many of its standard uncertainties.
const SIGNIFICANT: f64 = 5.0;
/// Least number of points: four unknowns, and some redundancy.
const LEAST: usize = 8;

/// Means at one point of the pattern.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Beam position by the readback, metres.
    pub beam: [f64; 2],
    /// The quantities.
    pub values: [f64; QUANTITIES],
}

/// The dependence of a quantity on the beam position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dependence {
    /// Change per change of the beam along x and y, minus the expected one.
    pub excess: [f64; 2],
    /// Standard uncertainty of each, from the scatter about the fit.
    pub sigma: [f64; 2],
}

impl Dependence {
    fn found(&self, floor: f64) -> bool {
        (0..2).any(|axis| self.excess[axis].abs() > floor.max(SIGNIFICANT * self.sigma[axis]))
    }
}

/// Result of a self-check.
#[derive(Clone, Debug, PartialEq)]
pub struct SelfCheck {
    /// The dependences, in the order of [`NAMES`].
    pub dependences: [Dependence; QUANTITIES],
}

impl SelfCheck {
    /// Evaluates points that were measured at equal intervals. `None` if there are too few, or if the beam did not
    /// move in two directions.
    pub fn new(points: &[Point]) -> Option<Self> {
        if points.len() < LEAST {
            return None;
        }
        let row = |k: usize| {
            let [x, y] = points[k].beam;
            SVector::<f64, 4>::new(1.0, k as f64 / points.len() as f64 - 0.5, x * 1e5, y * 1e5)
        };
        let normal: Matrix4<f64> = (0..points.len()).map(|k| row(k) * row(k).transpose()).sum();
        let inverse = normal.try_inverse().filter(|inverse| inverse.iter().all(|x| x.is_finite()))?;
        let sums: SMatrix<f64, 4, QUANTITIES> =
            (0..points.len()).map(|k| row(k) * SVector::from(points[k].values).transpose()).sum();
        let fit = inverse * sums;
        let freedom = (points.len() - 4) as f64;
        let dependences = std::array::from_fn(|quantity| {
            let misfit = |k: usize| points[k].values[quantity] - row(k).dot(&fit.column(quantity));
            let variance = (0..points.len()).map(|k| misfit(k).powi(2)).sum::<f64>() / freedom;
            let expected = [0, 1].map(|axis| f64::from(u8::from(quantity == 6 + axis)));
            Dependence {
                excess: [0, 1].map(|axis| fit[(2 + axis, quantity)] * 1e5 - expected[axis]),
                sigma: [0, 1].map(|axis| (variance * inverse[(2 + axis, 2 + axis)]).sqrt() * 1e5),
            }
        });
        Some(Self { dependences })
    }

    /// Whether the scatter is small enough to find a dependence at the floor. Otherwise the mirror was not at rest.
    pub fn conclusive(&self) -> bool {
        let sharp = |(d, floor): (&Dependence, f64)| d.sigma.iter().all(|s| s * SIGNIFICANT <= 2.0 * floor);
        self.dependences.iter().zip(FLOOR).all(sharp)
    }

    /// The quantities that depend on the beam position other than they should.
    pub fn found(&self) -> impl Iterator<Item = usize> {
        self.dependences
            .iter()
            .zip(FLOOR)
            .enumerate()
            .filter(|(_, (d, floor))| d.found(*floor))
            .map(|(i, _)| i)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATTERN: [[f64; 2]; 4] = [[20e-6, 0.0], [-20e-6, 0.0], [0.0, 20e-6], [0.0, -20e-6]];

    /// Points with this dependence of tz on x and of the offset on the beam, a drift, and an error of each point.
    fn points(tz: f64, scale: f64, error: f64) -> Vec<Point> {
        let point = |k: usize| {
            let beam = PATTERN[k % 4];
            let mut values = [1e-6 * k as f64; QUANTITIES];
            values.iter_mut().enumerate().for_each(|(i, v)| *v += error * ((7 * k + 3 * i) as f64).sin());
            values[2] += tz * beam[0];
            (values[6], values[7]) = (values[6] + scale * beam[0], values[7] + scale * beam[1]);
            Point { beam, values }
        };
        (0..16).map(point).collect()
    }

    fn found(points: &[Point]) -> (bool, Vec<usize>) {
        let check = SelfCheck::new(points).unwrap();
        (check.conclusive(), check.found().collect())
    }

    #[test]
    fn dependences_are_found_with_their_size_in_spite_of_a_drift() {
        assert_eq!(found(&points(0.0, 1.0, 0.05e-6)), (true, vec![]));
        assert_eq!(found(&points(0.015, 1.0, 0.05e-6)), (true, vec![]));
        let bad = points(0.06, 0.95, 0.05e-6);
        assert_eq!(found(&bad), (true, vec![2, 6, 7]));
        let check = SelfCheck::new(&bad).unwrap();
        assert!((check.dependences[2].excess[0] - 0.06).abs() < 0.005, "{check:?}");
        assert!((check.dependences[7].excess[1] + 0.05).abs() < 0.005, "{check:?}");
    }

    #[test]
    fn a_mirror_that_moves_allows_no_conclusion() {
        assert!(!found(&points(0.0, 1.0, 2e-6)).0);
    }

    #[test]
    fn too_few_points_and_a_beam_that_stands_still_are_refused() {
        assert_eq!(SelfCheck::new(&points(0.0, 1.0, 0.0)[..7]), None);
        let mut still = points(0.0, 1.0, 0.0);
        for point in &mut still {
            point.beam = [0.0; 2];
        }
        assert_eq!(SelfCheck::new(&still), None);
    }
}
