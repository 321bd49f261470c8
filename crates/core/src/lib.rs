//! From converter codes to poses and steering commands. Pure: no clock, no socket, no file, no configuration file.
//!
//! A [`Scan`](signals::Scan) of raw codes becomes a [`Sample`](signals::Sample) in metres and watts
//! ([`channels`]). The centering loop turns samples into commands for the stage that steers the laser
//! ([`centering`]). Estimation turns samples into pose reports ([`estimation`]). [`pipeline`] puts the three together;
//! its page has an example.
//!
//! Lengths are metres, angles radians, times nanoseconds of the monotonic clock ([`time`]).

pub mod centering;
pub mod channels;
pub mod estimation;
pub mod pipeline;
pub mod signals;
pub mod stamp;
pub mod steering;
pub mod telemetry;
pub mod time;
pub mod utc;
