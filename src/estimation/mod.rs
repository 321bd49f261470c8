//! Task 3: [`Sample`](crate::acquisition::Sample)s to [`PoseReport`]s.
//!
//! - [`core`]: what a sample (or a mean of several, [`block`]) says; pure.
//! - [`frames`]: from the sensor's world to the user's frame.
//! - [`noise`]: how noisy the signals are at present.
//! - [`report`], [`status`]: what comes out.
//! - [`task`]: the loop around it.

pub mod block;
pub mod core;
pub mod frames;
pub mod noise;
pub mod report;
pub mod status;
pub mod task;

pub use self::core::{Estimation, Settings};
pub use frames::Frames;
pub use report::PoseReport;
pub use status::Status;
