//! Detects steps of the laser power.
//!
//! A multiplexed converter samples its channels one after the other. If the power steps within a scan, only
//! one or two of the three PSDs show the step in this scan, and the others in the next. The ratios of such
//! powers are wrong, and so are the offset of the beam and the pose. The total power does not depend on the
//! position of the beam, and shows the step.

use serde::{Deserialize, Serialize};

/// Relative change of the total: a step of 5 % that only one of three powers shows in the first scan.
const LIMIT: f64 = 0.05 / 3.0;
/// The change must also exceed this many standard uncertainties of the difference of two totals.
const SIGNIFICANT: f64 = 5.0;
/// A change beyond this many standard uncertainties makes the power unsteady, even without a step: by chance
/// 12 times in 100 000.
const UNSTEADY: f64 = 4.0;
/// A step affects at most this many samples: two that show a part of it (the channel map interpolates every
/// channel to the time of its scan with the previous scan), and two more that are compared with those.
const LONGEST: u32 = 4;

/// State of the total power in a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Power {
    /// The power is constant.
    #[default]
    Steady,
    /// The power changes by more than its noise; the ratios may be wrong by as much.
    Unsteady,
    /// The power steps; the ratios may be wrong by more than can be stated.
    Step,
}

/// Compares the total power with those of the last two samples.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct PowerSteps {
    last: [Option<f64>; 2],
    row: u32,
}

impl PowerSteps {
    /// Discards the last samples: there was no light, or samples were lost.
    pub fn interrupt(&mut self) {
        *self = Self::default();
    }

    /// Takes the total power of a sample and its standard uncertainty, in the same unit.
    pub fn push(&mut self, total: f64, sigma: f64) -> Power {
        let judge = |last: &f64| {
            let change = (total - last).abs();
            let ratio = change / (std::f64::consts::SQRT_2 * sigma);
            if change > LIMIT * total.min(*last) && ratio > SIGNIFICANT {
                Power::Step
            } else if ratio > UNSTEADY {
                Power::Unsteady
            } else {
                Power::Steady
            }
        };
        let power = self.last.iter().flatten().map(judge).max().unwrap_or_default();
        self.row = if power == Power::Step { self.row.saturating_add(1) } else { 0 };
        self.last = [Some(total), self.last[0]];
        power
    }

    /// Whether the power changes for longer than a step does: noise or flicker.
    pub fn unsteady(&self) -> bool {
        self.row > LONGEST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// For each total: whether it counts as a step.
    fn beside(totals: &[f64]) -> Vec<bool> {
        let mut steps = PowerSteps::default();
        totals.iter().map(|total| steps.push(*total, 1e-3) == Power::Step).collect()
    }

    #[test]
    fn a_step_between_two_scans_affects_the_two_after_it() {
        for to in [0.5, 0.94, 1.06, 2.0] {
            assert_eq!(beside(&[1.0, 1.0, to, to, to]), [false, false, true, true, false], "{to}");
        }
    }

    #[test]
    fn a_step_within_a_scan_is_detected_in_parts() {
        for part in [1.02, 1.04] {
            let expected = [false, false, true, true, true, false];
            assert_eq!(beside(&[1.0, 1.0, part, 1.06, 1.06, 1.06]), expected, "{part}");
        }
    }

    #[test]
    fn slow_or_small_changes_and_noise_are_not_steps() {
        assert!(!beside(&[1.0, 1.016, 1.0]).contains(&true));
        assert!(!beside(&std::array::from_fn::<_, 50, _>(|k| 1.0 + 0.008 * k as f64)).contains(&true));
        let mut steps = PowerSteps::default();
        assert!(![1.0, 1.05, 0.98].into_iter().any(|total| steps.push(total, 0.011) == Power::Step));
        steps.interrupt();
        let states = [1.0, 1.03, 1.07].map(|total| steps.push(total, 0.01));
        assert_eq!(states, [Power::Steady, Power::Steady, Power::Unsteady]);
    }

    #[test]
    fn after_an_interruption_the_first_sample_is_not_compared() {
        let mut steps = PowerSteps::default();
        steps.push(1.0, 1e-6);
        steps.interrupt();
        assert_eq!([2.0, 2.1].map(|total| steps.push(total, 1e-6)), [Power::Steady, Power::Step]);
    }

    #[test]
    fn a_lasting_change_is_unsteady() {
        let mut steps = PowerSteps::default();
        let unsteady =
            [1.0, 1.1, 1.0, 1.1, 1.0, 1.1].map(|total| (steps.push(total, 1e-6), steps.unsteady()));
        assert_eq!(unsteady[0], (Power::Steady, false));
        assert_eq!(unsteady[1..5], [(Power::Step, false); 4]);
        assert_eq!(unsteady[5], (Power::Step, true));
    }
}
