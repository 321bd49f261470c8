//! The result of estimation for one moment.

use nalgebra::Matrix6;
use trifacet_optics::Pose;
use trifacet_wire::{LockState, Status};

use super::integrity::MeanResidual;
use crate::time::Mono;

/// The result of one sample or of a block of samples. An unknown value is `None`, never a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseReport {
    /// Index of the converter's sample; of the last one in a block; constant while there are no samples.
    pub index: u64,
    /// When the signals were sampled: the mean over a block; the present time while there are no samples.
    pub time: Mono,
    /// Standard uncertainty of `time` in nanoseconds, if known.
    pub time_sigma_ns: Option<f64>,
    /// When the solution was ready.
    pub solved: Mono,
    /// Status bits; `POSE_VALID` is set exactly if `pose` is `Some`.
    pub status: Status,
    /// Fingerprint of the configuration that defines the meaning of the pose.
    pub config: u32,
    /// State of the centering loop.
    pub lock: LockState,
    /// The pose, if known.
    pub pose: Option<Pose>,
    /// Covariance of tx, ty, tz (m), roll, pitch, yaw (rad); present with the pose.
    pub covariance: Option<Matrix6<f64>>,
    /// The part of the covariance that averaging does not reduce. Present with the pose in the user's frame; unknown
    /// before.
    pub systematic: Option<Matrix6<f64>>,
    /// Beam centre minus apex, across the beam, metres.
    pub offset: Option<[f64; 2]>,
    /// Distance between the beam position from the steering readback and the one from the nine signals,
    /// metres.
    pub steering_residual: Option<f64>,
    /// Mean of this difference over about a second; `None` until there are enough residuals.
    pub mean_residual: Option<MeanResidual>,
    /// Iterations of the solver.
    pub iterations: u8,
    /// Samples averaged into this report.
    pub averaged: u16,
    /// Samples lost since the last report.
    pub lost: u32,
    /// Spots in metres (u, v of A, B, C); NaN if there is no spot.
    pub spots: [f64; 6],
    /// Powers in watts; NaN if unknown.
    pub powers: [f64; 3],
    /// Steering position in metres: read back if `STEERING_MEASURED` is set, otherwise as commanded.
    pub steering: Option<[f64; 2]>,
}

impl PoseReport {
    /// A report with every field set but the systematic part, for examples and tests.
    pub fn example() -> Self {
        Self {
            index: 1234,
            time: Mono(1_000_000),
            time_sigma_ns: Some(1_840.0),
            solved: Mono(1_080_000),
            status: Status::POSE_VALID | Status::SIMULATED,
            config: 8,
            lock: LockState::Locked,
            pose: Some(Pose::from_array([1e-6, -2e-6, 3e-6, 4e-6, -5e-6, 6e-6])),
            covariance: Some(Matrix6::identity() * 4e-12),
            systematic: None,
            offset: Some([0.5e-6, -0.25e-6]),
            steering_residual: Some(1e-7),
            mean_residual: Some(MeanResidual { mean: [6e-8, -8e-8], limit: 5e-6, contradicts: false }),
            iterations: 2,
            averaged: 1,
            lost: 0,
            spots: [1e-3; 6],
            powers: [0.8e-3 / 3.0; 3],
            steering: Some([1e-5, 2e-5]),
        }
    }
}
