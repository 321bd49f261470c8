//! The calibration of the head: the record of how it was calibrated, and the configuration that the record belongs
//! to.
//!
//! A record is a file `calibration.json` beside the configuration (`calibration.record`). Its header is small and is
//! read at every start; the rest, from which uncertainties are computed, is read only by the commands that need it.

mod edits;
mod fingerprint;
mod points;
mod record;
mod record_file;
pub mod report;
mod tables;
mod verdict;

pub use edits::{edits, nominal};
pub use fingerprint::fingerprint;
pub use points::{Defaults, InputFile, Line, Measured};
pub use record::{FORMAT, RecordError, RecordHeader};
pub use record_file::{ParameterReport, Record, parameter_reports};
pub use tables::table;
pub use verdict::{Verdict, Wanted, before, verdict};
