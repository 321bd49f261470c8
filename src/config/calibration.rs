//! `[calibration]`: the record of the head's calibration.

use std::fs::File;
use std::io::BufReader;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::check::{Checker, above_zero};
use crate::calibration::{RecordError, RecordHeader, SharedSpread};

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
        let read = |path| RecordHeader::read(BufReader::new(File::open(path)?));
        self.record.as_ref().map(read).transpose()
    }

    /// Reads what the calibration leaves unknown of poses. Blocks.
    ///
    /// # Errors
    /// Fails if the record cannot be read or used.
    pub fn read_spread(&self) -> Result<Option<SharedSpread>, RecordError> {
        self.record.as_ref().map_or(Ok(None), |path| SharedSpread::read(File::open(path)?))
    }

    /// Checks that the record can be read. Blocks.
    pub(super) fn check_record(&self, mut at: Checker<'_>) {
        if let (Some(path), Err(error)) = (&self.record, self.read()) {
            let allowed = format!("a calibration record, relative to this file: {}: {error}", path.display());
            at.demand(false, "record", path.display(), allowed);
        }
    }
}
