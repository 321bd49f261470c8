//! Parameters of estimation, in SI units.

use std::sync::Arc;

use trifacet_optics::{Estimator, Model, Optics};
use trifacet_wire::Status;

use super::Frames;
use super::by_pose::ByPose;
use super::integrity::Readback;
use crate::channels::Amplifier;

/// Parameters of estimation.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The solver with its model of the head.
    pub estimator: Estimator,
    /// Samples per second.
    pub rate_hz: f64,
    /// Number of samples in a mean.
    pub average: u16,
    /// Standard uncertainty of a spot coordinate, metres; the configured value, a lower bound of the live
    /// one.
    pub spot_noise: f64,
    /// Standard uncertainty of a power, as a fraction of that power; the configured value, a lower bound.
    pub power_noise: f64,
    /// The amplifiers of the PSDs.
    pub amplifiers: [Amplifier; 3],
    /// Map from the readback of the stage to the position of the beam.
    pub readback: Readback,
    /// Whether the beam position from the readback enters the solution as two more signals.
    pub fuse: bool,
    /// A spot closer than this to the edge of its PSD sets a warning, metres.
    pub edge_margin: f64,
    /// Largest deviation of a power fraction from one third without a warning.
    pub balance_limit: f64,
    /// Standard uncertainties that averaging does not reduce, the same at every pose: x, y, z in metres; roll, pitch,
    /// yaw in radians. They are part of every stated covariance.
    pub systematic: [f64; 6],
    /// What averaging does not reduce and what depends on the pose. It is part of every stated covariance, too.
    pub by_pose: Option<Arc<ByPose>>,
    /// Status bits that are always set.
    pub fixed: Status,
    /// From the world frame of the head to the user's frame.
    pub frames: Frames,
    /// Fingerprint of the configuration, part of every report.
    pub config: u32,
}

impl Settings {
    /// Parameters of a nominal head for a solver: no averaging, no frames, no fusion.
    pub fn new(optics: Optics, model: Model) -> Self {
        Self {
            estimator: Estimator::new(optics, model),
            rate_hz: 1000.0,
            average: 1,
            spot_noise: 1.08e-6,
            power_noise: 1e-3,
            amplifiers: [Amplifier::Normalised; 3],
            readback: Readback::default(),
            fuse: false,
            edge_margin: 0.5e-3,
            balance_limit: 0.05,
            systematic: [0.0; 6],
            by_pose: None,
            fixed: Status::default(),
            frames: Frames::default(),
            config: 0,
        }
    }

    /// Whether a steering readback, where present, enters the solution as two more signals.
    pub fn fuses(&self) -> bool {
        self.fuse
    }
}
