//! The mean steering residual, for occasional readers.

use super::known_number::KnownNumber;
use crate::estimation::PoseReport;

/// Written by the estimation task, read on demand. The axes are not read in one step: either may be newer.
#[derive(Debug, Default)]
pub struct ResidualGauge([KnownNumber; 2]);

impl ResidualGauge {
    /// Records the mean of a report.
    pub fn set(&self, report: &PoseReport) {
        for (axis, number) in self.0.iter().enumerate() {
            number.set(report.mean_residual.map(|residual| residual.mean[axis]));
        }
    }

    /// The mean of the newest report, x and y, metres; `None` if it has none.
    pub fn mean(&self) -> Option<[f64; 2]> {
        Some([self.0[0].get()?, self.0[1].get()?])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_without_a_mean_clears_the_gauge() {
        let (gauge, report) = (ResidualGauge::default(), PoseReport::example());
        assert_eq!(gauge.mean(), None);
        gauge.set(&report);
        assert_eq!(gauge.mean(), report.mean_residual.map(|residual| residual.mean));
        gauge.set(&PoseReport { mean_residual: None, ..report });
        assert_eq!(gauge.mean(), None);
    }
}
