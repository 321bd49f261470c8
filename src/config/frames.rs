//! `[frames]`: in which frame, and of which point, poses are told.

use serde::{Deserialize, Serialize};
use trifacet_optics::{Pose, Rigid, Vec3};

use super::check::Checker;

/// `[frames]`: pose = tare^-1 * base * (pose of the mirror in the sensor's world) * tool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FramesConfig {
    /// The sensor's world in the user's base frame.
    pub base: TransformConfig,
    /// The point that matters, with its axes, in the mirror's frame.
    pub tool: TransformConfig,
    /// The pose that shall read zero, in the base frame.
    pub tare: TransformConfig,
}

/// A frame in another one. Angles as in a pose: `R = Rz(yaw) * Ry(pitch) * Rx(roll)`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TransformConfig {
    /// x, y, z.
    pub translation_mm: [f64; 3],
    /// Roll, pitch, yaw.
    pub rotation_deg: [f64; 3],
}

/// Digits of a tare: a tenth of a nanometre, and 17 picoradians.
const PER_MM: f64 = 1e7;
const PER_DEG: f64 = 1e9;

impl TransformConfig {
    /// As the file would have it: rounded to digits that no sensor sees.
    pub fn of(pose: &Pose) -> Self {
        // Adding zero turns -0.0 into 0.0.
        let round = |x: f64, per: f64| (x * per).round() / per + 0.0;
        Self {
            translation_mm: <[f64; 3]>::from(pose.t).map(|m| round(m * 1e3, PER_MM)),
            rotation_deg: [pose.roll, pose.pitch, pose.yaw].map(|rad| round(rad.to_degrees(), PER_DEG)),
        }
    }

    /// The transformation in SI units.
    pub fn build(&self) -> Rigid {
        let [roll, pitch, yaw] = self.rotation_deg.map(f64::to_radians);
        Rigid::from(&Pose { t: Vec3::from(self.translation_mm) / 1e3, roll, pitch, yaw })
    }

    fn check(&self, mut at: Checker<'_>) {
        at.numbers("translation_mm", &self.translation_mm, -100_000.0..=100_000.0);
        at.numbers("rotation_deg", &self.rotation_deg, -360.0..=360.0);
    }
}

impl FramesConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        self.base.check(at.section("base"));
        self.tool.check(at.section("tool"));
        self.tare.check(at.section("tare"));
    }
}
