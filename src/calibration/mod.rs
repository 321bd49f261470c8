//! The calibration of the head: the measurement, the fit, and the record of both. Which record belongs to a
//! configuration is a matter of [`config`](crate::config).
//!
//! - [`effort`]: how many samples a point needs. [`pose_list`]: the file of the planned poses.
//!   [`expectation`](mod@expectation): the uncertainty to expect. [`scan_pattern`]: the positions of a scan.
//! - [`bench`](mod@bench): the source, the loop and the stage during the measurement. [`measure`](mod@measure): a point, by
//!   [`rest`] (whether the mirror is at rest) and [`reading`] (the means of its signals). [`points_writer`]: the files of the points.
//! - [`report`]: what a fit found. [`certificate`]: the same for others, with what the laboratory states.

mod at_calibration;
pub mod bench;
pub mod certificate;
mod edits;
pub mod effort;
pub mod expectation;
pub mod measure;
mod points;
pub mod points_writer;
pub mod pose_list;
pub mod reading;
mod record_file;
pub mod report;
pub mod rest;
pub mod scan_pattern;
mod tables;
mod verdict;

pub use at_calibration::at_calibration;
pub use edits::{edits, nominal};
pub use points::{Defaults, InputFile, Line, Measured};
pub use record_file::{ParameterReport, Record, parameter_reports};
pub use tables::table;
pub use verdict::{Verdict, Wanted, before, pointing_advice, verdict};
