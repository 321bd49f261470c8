//! The share of the calibration in the uncertainty of a pose, from the calibration record.

use std::path::Path;

use nalgebra::Matrix6;
use trifacet_optics::calibration::result::Calibration;
use trifacet_optics::{Pose, Rigid};

use super::assessment::PoseCovariance;
use crate::calibration::Record;
use crate::config::RecordError;

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
        let record = Record::open(path)?;
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
        let covariances = self.calibration.relative_covariances(&readings, &reading(tare)?)?;
        covariances.into_iter().collect()
    }

    fn uncovered(&self, pose: &Pose) -> Vec<char> {
        let table = Pose::from(&(self.base * Rigid::from(pose) * self.tool));
        let Some(reading) = self.calibration.reading(&table) else { return vec!['A', 'B', 'C'] };
        let lattices = &self.calibration.layout.lattices;
        let outside =
            |psd: &usize| !lattices[*psd].covers([reading.spots[2 * psd], reading.spots[2 * psd + 1]]);
        (0..3).filter(outside).map(|psd| ['A', 'B', 'C'][psd]).collect()
    }

    fn table(&self) -> Rigid {
        self.tool
    }

    fn source(&self) -> String {
        self.source.clone()
    }
}
