//! The uncertainty of a pose relative to the tare that averaging does not reduce and that depends on the pose: what the
//! calibration leaves unknown, drift, the scale of the reference.
//!
//! It changes slowly with the pose. It is computed again when a spot has moved by [`STALE`] since it was computed last,
//! which takes some ten microseconds; the frames between carry the last one.

use std::sync::Arc;

use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};
use trifacet_optics::calibration::spread::{Spread, Zero};
use trifacet_optics::{Model, Optics, Pose, Vec2};

use super::Frames;
use crate::uncertainty::Stated;

/// Largest motion of a spot coordinate for which the last result is used, metres. The deviation by the calibration
/// changes by some 0.2 nm per micrometre within the readings of a calibration, hence by 4 nm over this.
pub const STALE: f64 = 20e-6;

/// The parts that depend on the pose.
#[derive(Clone, Debug)]
pub struct ByPose {
    calibration: Option<(Arc<Spread>, Zero)>,
    /// Everything else.
    stated: Option<Stated>,
}

/// A result, and the spots for which it was computed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Computed {
    spots: [f64; 6],
    /// In the user's frame: tx, ty, tz (m), roll, pitch, yaw (rad).
    pub covariance: Matrix6<f64>,
}

impl ByPose {
    /// The parts by a calibration, and by what is stated. `None` if there is neither. `zero`: the mirror, in the sensor's
    /// world frame, at the pose to which poses are relative. Without light on all PSDs there, the calibration has no part.
    pub fn new(
        spread: Option<Arc<Spread>>,
        stated: Option<Stated>,
        optics: &Optics,
        zero: &Pose,
    ) -> Option<Self> {
        let calibration = spread.and_then(|spread| {
            let reading = optics.trace(Model::Gaussian, zero, Vec2::zeros()).ok()?;
            let zero = spread.zero(zero, &reading.spots);
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
            covariance += frames.of_point(sensor, user, &relative.point, &relative.covariance);
        }
        if let Some(stated) = &self.stated {
            let (point, stated) = stated.at(sensor);
            covariance += frames.of_point(sensor, user, &point, &stated);
        }
        // A quadratic function may be a little below zero where a variance is zero.
        for i in 0..6 {
            covariance[(i, i)] = covariance[(i, i)].max(0.0);
        }
        covariance
    }
}
