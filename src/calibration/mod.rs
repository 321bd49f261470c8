//! The calibration of the head: the record of how it was calibrated, and the configuration that the record belongs
//! to.
//!
//! A record is a file `calibration.json` beside the configuration (`calibration.record`). Its header is small and is
//! read at every start, as is the covariance for the frames; the rest is read only by the commands that need it.
//!
//! - [`effort`]: how many samples a point needs. [`pose_list`]: the file of the planned poses.
//!   [`expectation`](mod@expectation): the uncertainty to expect. [`scan_pattern`]: the positions of a scan.
//! - [`bench`](mod@bench): the source, the loop and the stage during the measurement. [`measure`](mod@measure): a point, by
//!   [`rest`] (whether the mirror is at rest) and [`reading`] (the means of its signals). [`points_writer`]: the files of the points.
//! - [`report`]: what a fit found.

pub mod bench;
mod edits;
pub mod effort;
pub mod expectation;
mod fingerprint;
pub mod measure;
mod points;
pub mod points_writer;
pub mod pose_list;
pub mod reading;
mod record;
mod record_file;
pub mod report;
pub mod rest;
pub mod scan_pattern;
mod spread;
mod standing;
mod tables;
mod verdict;

pub use edits::{edits, nominal};
pub use fingerprint::fingerprint;
pub use points::{Defaults, InputFile, Line, Measured};
pub use record::{FORMAT, RecordError, RecordHeader};
pub use record_file::{ParameterReport, Record, parameter_reports};
pub use spread::SharedSpread;
pub use standing::{CalibrationState, Standing};
pub use tables::table;
pub use verdict::{Verdict, Wanted, before, verdict};
