//! The calibration of the head: the record of how it was calibrated, and the configuration that the record belongs
//! to.
//!
//! A record is a file `calibration.json` beside the configuration (`calibration.record`). Its header is small and is
//! read at every start; the rest, from which uncertainties are computed, is read only by the commands that need it.
//!
//! - [`effort`]: how many samples a point needs. [`pose_list`]: the file of the planned poses.
//! - [`bench`](mod@bench): the source, the loop and the stage during the measurement. [`measure`](mod@measure): a point, by
//!   [`rest`] (whether the mirror is at rest) and [`reading`] (the means of its signals). [`points_writer`]: the files of the points.

pub mod bench;
pub mod effort;
mod fingerprint;
pub mod measure;
pub mod points_writer;
pub mod pose_list;
pub mod reading;
mod record;
pub mod rest;

pub use fingerprint::fingerprint;
pub use record::{FORMAT, RecordError, RecordHeader};
