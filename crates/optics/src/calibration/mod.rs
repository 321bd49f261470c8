//! Calibration of a head: its geometry, the errors of its PSDs and the frames, from measured points.
//!
//! - [`plan`]: poses that cover the PSDs evenly.

pub mod plan;
