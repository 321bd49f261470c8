//! Estimation: [`Sample`](crate::signals::Sample)s to [`PoseReport`]s. Pure.
//!
//! - [`estimator`]: a sample, or the mean of a [`block`], to a report.
//! - [`settings`]: its parameters.
//! - `signal_checks`, [`power_step`]: conditions without a pose; [`integrity`]: conditions for a doubtful
//!   one.
//! - [`forecast`], [`exposure`]: which changes of the power are foreseen, and what the others do to the signals.
//! - [`frames`]: from the world frame of the head to the user's frame.
//! - [`noise`], [`power_noise`]: the present noise of the signals.
//! - [`by_pose`]: the uncertainty that averaging does not reduce and that depends on the pose.
//! - [`report`]: the result.

pub mod block;
pub mod by_pose;
pub mod estimator;
pub mod exposure;
pub mod forecast;
pub mod frames;
pub mod integrity;
pub mod noise;
pub mod power_noise;
pub mod power_step;
mod power_step_0_1;
pub mod report;
mod second_differences;
pub mod settings;
mod signal_checks;
#[cfg(test)]
mod tests;

pub use estimator::{Estimation, EstimatorState};
pub use frames::Frames;
pub use report::PoseReport;
pub use settings::Settings;
