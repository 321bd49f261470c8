//! `[frames]`: the coordinate frames and the point for which poses are published.

use serde::{Deserialize, Serialize};
use trifacet_optics::{Pose, Rigid, Vec3};

use super::check::Checker;

/// Settings of `[frames]`: pose = tare^-1 * base * (pose of the mirror in the sensor's world) * tool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FramesConfig {
    /// The sensor's world frame in the user's base frame.
    pub base: TransformConfig,
    /// The point of interest and its axes, in the frame of the mirror.
    pub tool: TransformConfig,
    /// The pose that is to read zero, in the base frame.
    pub tare: TransformConfig,
}

/// Pose of one frame in another. Angles as in a pose: `R = Rz(yaw) * Ry(pitch) * Rx(roll)`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TransformConfig {
    /// Translation x, y, z, millimetres.
    pub translation_mm: [f64; 3],
    /// Roll, pitch, yaw, degrees.
    pub rotation_deg: [f64; 3],
}

/// Steps per millimetre to which a tare is rounded: 0.1 nm. Angles are rounded to 17 prad.
const PER_MM: f64 = 1e7;
const PER_DEG: f64 = 1e9;

impl TransformConfig {
    /// A pose in the units of the file, rounded to steps far below the resolution of the sensor.
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

    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.numbers("translation_mm", &self.translation_mm, -100_000.0..=100_000.0);
        at.numbers("rotation_deg", &self.rotation_deg, -360.0..=360.0);
    }
}

impl FramesConfig {
    /// Whether there is a tare.
    pub fn is_tared(&self) -> bool {
        self.tare != TransformConfig::default()
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        self.base.check(at.section("base"));
        self.tool.check(at.section("tool"));
        self.tare.check(at.section("tare"));
    }
}
