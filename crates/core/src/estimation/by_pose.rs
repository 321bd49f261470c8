//! The uncertainty of a pose relative to the tare that averaging does not reduce and that depends on the pose: what the
//! calibration leaves unknown, drift, the scale of the reference.
//!
//! It changes slowly with the pose. It is computed again when a spot has moved by [`STALE`] since it was computed last,
//! which takes some ten microseconds; the frames between carry the last one.

use std::sync::Arc;

use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};
use trifacet_optics::calibration::spread::{Spread, Zero};
use trifacet_optics::quadratic::Quadratic;
use trifacet_optics::{Model, Optics, Pose, Vec2};

use super::Frames;

/// Largest motion of a spot coordinate for which the last result is used, metres. The deviation by the calibration
/// changes by some 0.2 nm per micrometre within the readings of a calibration, hence by 4 nm over this.
pub const STALE: f64 = 20e-6;

/// Elements of the lower triangle of a 6 x 6 matrix.
pub const TRIANGLE: usize = 21;

/// The parts that depend on the pose.
#[derive(Clone, Debug)]
pub struct ByPose {
    calibration: Option<(Arc<Spread>, Zero)>,
    /// Covariance of everything else: lower triangle by rows, as a function of the user's pose.
    stated: Option<Quadratic>,
}

/// A result, and the spots for which it was computed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Computed {
    spots: [f64; 6],
    /// In the user's frame: tx, ty, tz (m), roll, pitch, yaw (rad).
    pub covariance: Matrix6<f64>,
}

impl ByPose {
    /// The parts by a calibration, and by what is stated: the covariance (lower triangle by rows, m and rad) as a
    /// function of the user's pose. `None` if there is neither.
    ///
    /// Poses are relative to the zero of the user's frame. If the mirror cannot be there, as with a tare that only
    /// moves the coordinates, the calibration counts relative to the zero of its reference.
    pub fn new(
        spread: Option<Arc<Spread>>,
        stated: Option<Quadratic>,
        optics: &Optics,
        frames: &Frames,
    ) -> Option<Self> {
        let stated = stated.filter(|stated| stated.is_usable(TRIANGLE));
        let calibration = spread.and_then(|spread| {
            let zero = [frames.zero(), spread.zero_pose()].into_iter().find_map(|pose| {
                let reading = optics.trace(Model::Gaussian, &pose, Vec2::zeros()).ok()?;
                Some(spread.zero(&pose, &reading.spots))
            })?;
            Some((spread, zero))
        });
        (calibration.is_some() || stated.is_some()).then_some(Self { calibration, stated })
    }

    /// Computes the covariance for a pose in the world frame of the head and its spots, unless the last one holds.
    pub fn refresh(&self, last: &mut Option<Computed>, sensor: &Pose, frames: &Frames, spots: &[f64; 6]) {
        let near = |last: &Computed| last.spots.iter().zip(spots).all(|(a, b)| (a - b).abs() <= STALE);
        if !last.as_ref().is_some_and(near) {
            let covariance = frames.pose(sensor).map(|user| self.covariance(sensor, &user, frames, spots));
            *last = covariance.map(|covariance| Computed { spots: *spots, covariance });
        }
    }

    /// The covariance of the pose `user` in the user's frame: m and rad.
    pub fn covariance(&self, sensor: &Pose, user: &Pose, frames: &Frames, spots: &[f64; 6]) -> Matrix6<f64> {
        let mut covariance = Matrix6::zeros();
        if let Some((spread, zero)) = &self.calibration {
            let relative = spread.relative(zero, sensor, spots);
            covariance = frames.of_point(sensor, user, &relative.point, &relative.covariance);
        }
        if let Some(stated) = &self.stated {
            let mut triangle = [0.0; TRIANGLE];
            stated.at(&user.to_array(), &mut triangle);
            let places = (0..6).flat_map(|i| (0..=i).map(move |k| (i, k)));
            for ((i, k), value) in places.zip(triangle) {
                covariance[(i, k)] += value;
                if i != k {
                    covariance[(k, i)] += value;
                }
            }
        }
        // The quadratic function may be a little below zero where a variance is zero.
        for i in 0..6 {
            covariance[(i, i)] = covariance[(i, i)].max(0.0);
        }
        covariance
    }
}
