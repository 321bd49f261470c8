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
/// Covariances of a pose: tx, ty, tz in metres, roll, pitch, yaw in radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Covariances {
    /// By the noise of its own readings.
    pub(super) random: Matrix6<f64>,
    /// By what averaging does not reduce, with the calibration's share.
    pub(super) systematic: Matrix6<f64>,
    /// By what the calibration leaves unknown.
    pub(super) calibration: Matrix6<f64>,
}

impl Covariances {
    pub(super) fn total(&self) -> Matrix6<f64> {
        self.random + self.systematic
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

    /// Adds the share of the calibration, that of the pose relative to the tare.
    pub(super) fn add_calibration(&mut self, calibration: Matrix6<f64>) {
        self.calibration = calibration;
        self.systematic += calibration;
    }
}
