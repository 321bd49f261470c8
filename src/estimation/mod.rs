//! Task 3: [`Sample`](crate::acquisition::Sample)s to [`PoseReport`]s.
//!
//! - [`core`]: what a sample (or a mean of several, [`block`]) says; pure.
//! - [`settings`]: what the configuration says of it.
//! - [`light`], [`power_step`]: what leaves no pose; [`integrity`]: what makes one doubtful.
//! - [`frames`]: from the sensor's world to the user's frame.
//! - [`noise`]: how noisy the signals are at present.
//! - [`pulse`]: whether the loop still does what it said.
//! - [`report`], [`status`]: what comes out.
//! - [`task`]: the loop around it.

pub mod block;
pub mod core;
pub mod frames;
pub mod integrity;
mod light;
pub mod noise;
pub mod power_step;
pub mod pulse;
pub mod report;
pub mod settings;
pub mod task;

pub use frames::Frames;
pub use report::PoseReport;
pub use settings::Settings;

pub use self::core::{Estimation, Memory};

#[cfg(test)]
mod tests;
