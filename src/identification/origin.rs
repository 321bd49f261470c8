//! What a large origin can mean: a displaced laser, or a displaced PSD.
//!
//! Steps of the stage cannot distinguish the two. A displaced laser is what the origin is for: the poses stay right. A
//! displaced PSD shifts the solved pose, and with it the origin; the origin then only hides the error.

use trifacet_core::steering::BeamPoint;
use trifacet_optics::{Estimator, Model, Optics, Pose, Signals, Vec2};

/// Displacement with which the effect of a PSD is computed, metres. The effect is linear.
const TRIAL: f64 = 50e-6;
/// A PSD that moves the origin by less than this part of its displacement does not explain a large origin.
const EXPLAINS: f64 = 0.2;

/// The largest errors of the pose if this origin comes from the displacement of one PSD along one of its axes: x, y, z
/// in metres; roll, pitch, yaw in radians.
pub fn errors_of_displaced_psd(optics: Optics, origin: BeamPoint) -> [f64; 6] {
    let estimator = Estimator::new(optics, Model::Gaussian);
    let size = origin[0].hypot(origin[1]);
    let mut largest = [0.0_f64; 6];
    for coordinate in 0..6 {
        let Some((pose, shift)) = displaced(&estimator, coordinate) else { continue };
        let scale = size / shift;
        for (largest, error) in largest.iter_mut().zip(pose.to_array()) {
            *largest = largest.max(error.abs() * scale);
        }
    }
    largest
}

/// The wrong pose of a mirror at rest if this coordinate of a spot is displaced, and the distance by which the origin
/// moves.
fn displaced(estimator: &Estimator, coordinate: usize) -> Option<(Pose, f64)> {
    let optics = estimator.optics();
    let reading = optics.trace(Model::Gaussian, &Pose::default(), Vec2::zeros()).ok()?;
    let mut signals = Signals { spots: reading.spots, powers: reading.powers };
    signals.spots[coordinate] += TRIAL;
    let solution = estimator.solve(&signals, None).ok()?;
    let shift = (optics.across(solution.pose.t) + solution.offset).norm();
    (shift > EXPLAINS * TRIAL).then_some((solution.pose, shift))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn a_displaced_psd_is_found_with_the_errors_that_it_causes() {
        let optics = Config::default().optics().unwrap();
        let estimator = Estimator::new(optics.clone(), Model::Gaussian);
        let reading = optics.trace(Model::Gaussian, &Pose::default(), Vec2::zeros()).unwrap();
        for coordinate in 0..6 {
            let mut signals = Signals { spots: reading.spots, powers: reading.powers };
            signals.spots[coordinate] += 500e-6;
            let solution = estimator.solve(&signals, None).unwrap();
            let origin = optics.across(solution.pose.t) + solution.offset;
            let stated = errors_of_displaced_psd(optics.clone(), BeamPoint([origin.x, origin.y]));
            if origin.norm() < 100e-6 {
                continue;
            }
            for (axis, (error, stated)) in solution.pose.to_array().into_iter().zip(stated).enumerate() {
                assert!(
                    error.abs() <= 1.02 * stated + 1e-9,
                    "coordinate {coordinate}, axis {axis}: {error} of {stated}"
                );
            }
        }
        let stated = errors_of_displaced_psd(optics, BeamPoint([333e-6, 0.0]));
        assert!(stated[0] > 100e-6 && stated[3..].iter().any(|sigma| *sigma > 300e-6), "{stated:?}");
    }
}
