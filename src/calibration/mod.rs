//! The calibration of the head: the record of how it was calibrated, and the configuration that the record belongs
//! to.
//!
//! A record is a file `calibration.json` beside the configuration (`calibration.record`). Its header is small and is
//! read at every start; the rest, from which uncertainties are computed, is read only by the commands that need it.

mod fingerprint;
mod record;
mod standing;

pub use fingerprint::fingerprint;
pub use record::{FORMAT, RecordError, RecordHeader};
pub use standing::{Calibration, Standing};
