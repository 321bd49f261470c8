//! Estimation: [`Sample`](crate::signals::Sample)s to [`PoseReport`]s. Pure.
//!
//! - [`estimator`]: a sample, or a mean of several ([`block`]), to a report.
//! - [`settings`]: its parameters.
//! - `signal_checks`, [`power_step`]: what leaves no pose; [`integrity`]: what makes one doubtful.
//! - [`frames`]: from the sensor's world to the user's frame.
//! - [`noise`]: how noisy the signals are at present.
//! - [`report`]: what comes out.

pub mod block;
pub mod estimator;
pub mod frames;
pub mod integrity;
pub mod noise;
pub mod power_step;
pub mod report;
pub mod settings;
mod signal_checks;
#[cfg(test)]
mod tests;

pub use estimator::{Estimation, EstimatorState};
pub use frames::Frames;
pub use report::PoseReport;
pub use settings::Settings;
