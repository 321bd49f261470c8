//! Steps of the laser's power.
//!
//! A converter that takes its channels one after the other sees only a part of a step that comes within a
//! scan, on one or two of the three PSDs, and the next scan the rest. The ratios of such powers, and with
//! them the beam's offset and the pose, are wrong. The total does not depend on where the beam is, so it
//! tells.

/// A step of 5 % that only one of three powers shows in the first of its scans.
const LIMIT: f64 = 0.05 / 3.0;
/// And so many deviations of the difference of two totals.
const SIGNIFICANT: f64 = 5.0;
/// A step is over after so many scans: two that show a part of it each, and one more that is compared with
/// the first of them.
const LONGEST: u32 = 3;

/// Compares the total power with that of the last two samples.
#[derive(Clone, Debug, Default)]
pub struct PowerSteps {
    last: [Option<f64>; 2],
    row: u32,
}

impl PowerSteps {
    /// The last samples are none to compare with: it was dark, or samples were lost.
    pub fn interrupt(&mut self) {
        *self = Self::default();
    }

    /// Takes the total power of a sample; whether it stands beside a step. `noise` gives one standard
    /// deviation of the total.
    pub fn push(&mut self, total: f64, noise: impl Fn() -> f64) -> bool {
        let differs = |last: &f64| {
            let change = (total - last).abs();
            change > LIMIT * total.min(*last) && change > SIGNIFICANT * std::f64::consts::SQRT_2 * noise()
        };
        let step = self.last.iter().flatten().any(differs);
        self.row = if step { self.row.saturating_add(1) } else { 0 };
        self.last = [Some(total), self.last[0]];
        step
    }

    /// The power changes for longer than a step does: it is noise, or it flickers.
    pub fn unsteady(&self) -> bool {
        self.row > LONGEST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Which of these totals stand beside a step.
    fn beside(totals: &[f64]) -> Vec<bool> {
        let mut steps = PowerSteps::default();
        totals.iter().map(|total| steps.push(*total, || 1e-3)).collect()
    }

    #[test]
    fn a_step_between_two_scans_spoils_the_two_after_it() {
        for to in [0.5, 0.94, 1.06, 2.0] {
            assert_eq!(beside(&[1.0, 1.0, to, to, to]), [false, false, true, true, false], "{to}");
        }
    }

    #[test]
    fn a_step_within_a_scan_shows_in_parts() {
        for part in [1.02, 1.04] {
            let expected = [false, false, true, true, true, false];
            assert_eq!(beside(&[1.0, 1.0, part, 1.06, 1.06, 1.06]), expected, "{part}");
        }
    }

    #[test]
    fn what_is_slow_or_small_or_noise_is_no_step() {
        assert!(!beside(&[1.0, 1.016, 1.0]).contains(&true));
        assert!(!beside(&std::array::from_fn::<_, 50, _>(|k| 1.0 + 0.008 * k as f64)).contains(&true));
        let mut steps = PowerSteps::default();
        assert!(![1.0, 1.05, 0.98].into_iter().any(|total| steps.push(total, || 0.011)));
    }

    #[test]
    fn after_an_interruption_there_is_nothing_to_compare_with() {
        let mut steps = PowerSteps::default();
        steps.push(1.0, || 0.0);
        steps.interrupt();
        assert!(!steps.push(2.0, || 0.0));
        assert!(steps.push(2.1, || 0.0) && !steps.unsteady());
    }

    #[test]
    fn what_does_not_end_is_unsteady() {
        let mut steps = PowerSteps::default();
        let unsteady = [1.0, 1.1, 1.0, 1.1, 1.0].map(|total| (steps.push(total, || 0.0), steps.unsteady()));
        assert_eq!(unsteady, [(false, false), (true, false), (true, false), (true, false), (true, true)]);
    }
}
