//! `[calibration]`: the record of the head's calibration, and whether it is valid.
//!
//! A record is a file `calibration.json` beside the configuration (`calibration.record`). Its header is small and is
//! read at every start, as is the covariance for the frames; the rest is read only by the commands that need it.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

mod fingerprint;
mod record;
mod spread;
mod standing;

pub use fingerprint::fingerprint;
pub use record::{AtCalibration, FORMAT, RecordError, RecordHeader, SteeringResidual};
pub(crate) use record::{contents, parsed};
pub use spread::SharedSpread;
pub(crate) use spread::spread_bytes;
pub use standing::{CalibrationState, Standing};

use super::check::{Checker, above_zero};

/// Settings of `[calibration]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CalibrationConfig {
    /// The record that a calibration has written, relative to the configuration file. `None`: not calibrated.
    pub record: Option<PathBuf>,
    /// Days from the date of the record after which the calibration is no longer valid. `None`: only the record states
    /// a limit, if any.
    pub expires_days: Option<f64>,
}

impl CalibrationConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.optional("expires_days", self.expires_days, above_zero(36_500.0));
    }

    /// The header of the record, if the configuration names one. Blocks.
    ///
    /// # Errors
    /// Fails if the record cannot be read or used.
    pub fn read(&self) -> Result<Option<RecordHeader>, RecordError> {
        self.record.as_deref().map(RecordHeader::open).transpose()
    }

    /// Reads what the calibration leaves unknown of poses. Blocks.
    ///
    /// # Errors
    /// Fails if the record cannot be read or used.
    pub fn read_spread(&self) -> Result<Option<SharedSpread>, RecordError> {
        self.record.as_deref().map_or(Ok(None), SharedSpread::open)
    }

    /// Checks that the record can be read. Blocks.
    pub(super) fn check_record(&self, mut at: Checker<'_>) {
        if let (Some(path), Err(error)) = (&self.record, self.read()) {
            let allowed = format!("a calibration record, relative to this file: {}: {error}", path.display());
            at.demand(false, "record", path.display(), allowed);
        }
    }
}
