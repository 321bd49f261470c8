//! The share of the calibration in the uncertainty of a pose, from the calibration record.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use nalgebra::Matrix6;
use trifacet_optics::calibration::result::Calibration;
use trifacet_optics::{Pose, Rigid};

use super::assessment::PoseCovariance;
use crate::calibration::{Record, RecordError};

/// A calibration record, read whole.
pub struct Recorded {
    calibration: Calibration,
    base: Rigid,
    tool: Rigid,
    source: String,
}

impl Recorded {
    /// Reads a record. Blocks.
    ///
    /// # Errors
    /// The file cannot be read, or is not a record.
    pub fn read(path: &Path) -> Result<Self, RecordError> {
        let record = Record::read(BufReader::new(File::open(path)?))?;
        let calibration = record.calibration()?;
        let [base, tool] = calibration.base_and_tool();
        Ok(Self { calibration, base, tool, source: format!("calibration record of {}", record.header.day()) })
    }
}

impl PoseCovariance for Recorded {
    fn relative_to(&self, tare: &Pose, poses: &[Pose]) -> Option<Vec<Matrix6<f64>>> {
        // The record knows readings: those of the poses of the reference's table.
        let reading = |sensor: &Pose| {
            self.calibration.reading(&Pose::from(&(self.base * Rigid::from(sensor) * self.tool)))
        };
        let readings: Vec<_> = poses.iter().map(reading).collect::<Option<_>>()?;
        let covariances =
            self.calibration.relative_covariances(&readings, &reading(tare)?, &Rigid::identity())?;
        covariances.into_iter().collect()
    }

    fn table(&self) -> Rigid {
        self.tool
    }

    fn source(&self) -> String {
        self.source.clone()
    }
}
