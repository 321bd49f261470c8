//! The parts of the uncertainty of a pose.

use nalgebra::Matrix6;

/// Columns of the standard uncertainties.
pub(super) const STD: [&str; 6] =
    ["std_tx_m", "std_ty_m", "std_tz_m", "std_roll_rad", "std_pitch_rad", "std_yaw_rad"];
/// Columns of their systematic part.
pub(super) const SYS_STD: [&str; 6] = [
    "sys_std_tx_m",
    "sys_std_ty_m",
    "sys_std_tz_m",
    "sys_std_roll_rad",
    "sys_std_pitch_rad",
    "sys_std_yaw_rad",
];
/// Columns of the share of the calibration, a part of the systematic part.
pub(super) const CAL_STD: [&str; 6] = [
    "cal_std_tx_m",
    "cal_std_ty_m",
    "cal_std_tz_m",
    "cal_std_roll_rad",
    "cal_std_pitch_rad",
    "cal_std_yaw_rad",
];

/// Covariances of a pose: tx, ty, tz in metres, roll, pitch, yaw in radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Covariances {
    /// By the noise of its own readings.
    pub(super) random: Matrix6<f64>,
    /// By what averaging does not reduce.
    pub(super) systematic: Matrix6<f64>,
    /// The share of the calibration in it.
    pub(super) calibration: Matrix6<f64>,
}

impl Covariances {
    pub(super) fn total(&self) -> Matrix6<f64> {
        self.random + self.systematic
    }

    /// Adds the share of the calibration.
    pub(super) fn add_calibration(&mut self, share: &Matrix6<f64>) {
        self.systematic += share;
        self.calibration = *share;
    }

    /// Of a pose relative to another one. Both have noise of their own. The systematic part is the stated one of a pose
    /// relative to a tare: it counts once.
    pub(super) fn of_difference(&self, zero: &Self, by_pose: &Matrix6<f64>, by_zero: &Matrix6<f64>) -> Self {
        let seen = |slope: &Matrix6<f64>, covariance: &Matrix6<f64>| slope * covariance * slope.transpose();
        Self {
            random: seen(by_pose, &self.random) + seen(by_zero, &zero.random),
            systematic: seen(by_pose, &self.systematic),
            calibration: Matrix6::zeros(),
        }
    }
}
