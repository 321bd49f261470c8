//! The mean steering residual, for occasional readers.

use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

use crate::estimation::PoseReport;

/// Written by the estimation task, read on demand. The axes are not read in one step: either may be newer.
#[derive(Debug)]
pub struct ResidualGauge([AtomicU64; 2]);

impl Default for ResidualGauge {
    fn default() -> Self {
        Self([f64::NAN; 2].map(|unknown| AtomicU64::new(unknown.to_bits())))
    }
}

impl ResidualGauge {
    /// Records the mean of a report.
    pub fn set(&self, report: &PoseReport) {
        let mean = report.mean_residual.map_or([f64::NAN; 2], |residual| residual.mean);
        self.0.iter().zip(mean).for_each(|(axis, metres)| axis.store(metres.to_bits(), Relaxed));
    }

    /// The mean of the newest report, x and y, metres; `None` if it has none.
    pub fn mean(&self) -> Option<[f64; 2]> {
        let [x, y] = [0, 1].map(|axis: usize| f64::from_bits(self.0[axis].load(Relaxed)));
        (x.is_finite() && y.is_finite()).then_some([x, y])
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
