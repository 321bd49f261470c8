//! From converter codes to poses and steering commands. Pure: no clock, no socket, no file.
//!
//! - [`channels`]: a [`Scan`](signals::Scan) of raw codes to a [`Sample`](signals::Sample) in metres and watts.
//! - [`centering`]: samples to commands for the stage that steers the laser.
//! - [`estimation`]: samples to pose reports. [`stamp`]: reports to frames.
//! - [`light_checks`]: samples to doubts about the light. [`calibration_drift`]: reports to the drift since the calibration.
//! - [`self_check`]: does the pose depend on the beam position?
//! - [`pipeline`]: mapping, centering and estimation together, with an example.
//! - [`uncertainty`]: what a pose depends on, and how much.
//! - [`signals`], [`steering`], [`time`], [`utc`], [`telemetry`]: types that these parts share.
//!
//! Lengths are metres, angles radians, times nanoseconds of the monotonic clock ([`time`]).

pub mod calibration_drift;
pub mod centering;
pub mod channels;
pub mod estimation;
pub mod light_checks;
pub mod pipeline;
pub mod self_check;
pub mod sent_commands;
pub mod signals;
pub mod stamp;
pub mod steering;
pub mod telemetry;
pub mod time;
pub mod uncertainty;
pub mod utc;
