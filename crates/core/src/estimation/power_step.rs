//! Detects steps of the laser power.
//!
//! A multiplexed converter samples its channels one after the other. If the power steps within a scan, only
//! one or two of the three PSDs show the step in this scan, and the others in the next. The ratios of such
//! powers are wrong, and so are the offset of the beam and the pose. The total power does not depend on the
//! position of the beam, and shows the step.
//!
//! A power that changes periodically is no step: the [`forecast`](super::forecast) predicts it.

use serde::{Deserialize, Serialize};

use super::exposure::{Doubt, OF_ONE};
use super::forecast::Forecast;

/// Change of one power that makes a step: the linear propagation of uncertainties holds up to it.
const LIMIT: f64 = 0.05;
/// The change must also exceed this many of its standard uncertainties.
const SIGNIFICANT: f64 = 5.0;
/// A change beyond this many standard uncertainties makes the power unsteady, even without a step: by chance
/// 6 times in 100 000.
const UNSTEADY: f64 = 4.0;
/// If more than this part of the last samples is not steady, the power flickers or is noisy. A step shows in two
/// samples, because the channel map interpolates every channel to the time of its scan with the previous scan.
const RESTLESS: f64 = 0.4;
/// Averaging length of that part, samples.
const SHORT: f64 = 16.0;
/// Averaging length of the usual change, samples.
const WINDOW: f64 = 64.0;
/// A prediction counts if it leaves less than this part of the change. It has more noise than the change.
const BETTER: f64 = 0.5;
/// The largest second difference decreases by this factor from sample to sample.
const DECAY: f64 = 0.9;

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

/// Compares the total power with those of the last samples.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct PowerSteps {
    /// The last totals, the newest one first; the second one is unknown after a step.
    pub(super) last: [Option<f64>; 2],
    /// Number of successive samples with a step.
    pub(super) row: u32,
}

/// What was learnt of the changes of the power.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct PowerHistory {
    forecast: Forecast,
    /// Mean square of the relative change that was not predicted, without steps.
    usual: f64,
    /// Part of the last samples whose power is not steady.
    changing: f64,
    /// Largest second difference of the last samples, relative to the total.
    second_difference: f64,
}

/// A change of the total that was not predicted, relative to the total.
#[derive(Clone, Copy, Debug)]
struct Surprise {
    size: f64,
    sigma: f64,
}

impl PowerSteps {
    /// Discards the last samples: there was no light, or samples were lost.
    pub fn interrupt(&mut self, history: &mut PowerHistory) {
        *self = Self::default();
        history.forecast.interrupt();
    }

    /// Takes the total power of a sample and its standard uncertainty, in the same unit.
    pub fn push(&mut self, total: f64, sigma: f64, history: &mut PowerHistory) -> (Power, Doubt) {
        let Some(last) = self.last[0] else {
            self.last[0] = Some(total);
            return (Power::Steady, Doubt { second_difference: history.second_difference, step: 0.0 });
        };
        // The second sample of a step can look like the next one of a sine: it is not predicted.
        let expected = history.forecast.next().filter(|_| self.row != 1);
        let in_units = |change: f64, sigmas: f64| Surprise {
            size: (total - last - change).abs() / total.min(last),
            sigma: (sigmas * sigma / total.min(last)).max(history.usual.sqrt()),
        };
        let mut surprise = in_units(0.0, std::f64::consts::SQRT_2);
        if let Some(expected) = expected.map(|next| in_units(next.change, next.sigma))
            && expected.size < BETTER * surprise.size
        {
            surprise = expected;
        }
        let power = surprise.judge();
        let changes = power != Power::Steady;
        self.row = if power == Power::Step { self.row.saturating_add(1) } else { 0 };
        history.changing += (f64::from(u8::from(changes)) - history.changing) / SHORT;
        let single = changes && !history.restless();
        history.curve(self.last[1].map(|before| (total - 2.0 * last + before) / total), sigma / total);
        if single {
            history.forecast.skip(total - last); // the parts of a step must not become a pattern
        } else {
            history.forecast.learn(total - last, total);
            history.usually(surprise.size);
        }
        self.last = [Some(total), Some(last).filter(|_| !single)];
        let step = if changes { surprise.size } else { 0.0 };
        (power, Doubt { step, second_difference: history.second_difference })
    }
}

impl Surprise {
    fn judge(&self) -> Power {
        let ratio = self.size / self.sigma;
        if OF_ONE * self.size > LIMIT && ratio > SIGNIFICANT {
            Power::Step
        } else if ratio > UNSTEADY {
            Power::Unsteady
        } else {
            Power::Steady
        }
    }
}

impl PowerHistory {
    /// Whether the power changes for longer than a step does: noise or flicker.
    pub fn restless(&self) -> bool {
        self.changing > RESTLESS
    }

    /// Takes a change that is no step.
    fn usually(&mut self, change: f64) {
        self.usual += (change * change - self.usual) / WINDOW;
    }

    /// Takes the second difference of the total, if known; it counts if it is larger than its noise.
    fn curve(&mut self, difference: Option<f64>, sigma: f64) {
        let noise = UNSTEADY * 6.0_f64.sqrt() * sigma;
        let known = self.second_difference * DECAY;
        let largest = difference.map_or(known, |difference| known.max(difference.abs()));
        self.second_difference = if largest > noise { largest } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The state for each total, with its doubt.
    fn states(totals: impl IntoIterator<Item = f64>, sigma: f64) -> Vec<(Power, Doubt)> {
        let (mut steps, mut history) = (PowerSteps::default(), PowerHistory::default());
        totals.into_iter().map(|total| steps.push(total, sigma, &mut history)).collect()
    }

    /// For each total: whether it counts as a step.
    fn beside(totals: &[f64]) -> Vec<bool> {
        states(totals.iter().copied(), 1e-3).iter().map(|(power, _)| *power == Power::Step).collect()
    }

    #[test]
    fn a_step_between_two_scans_affects_the_first_one_after_it() {
        for to in [0.5, 0.94, 1.06, 2.0] {
            assert_eq!(beside(&[1.0, 1.0, to, to, to]), [false, false, true, false, false], "{to}");
        }
    }

    #[test]
    fn a_step_within_a_scan_is_detected_in_parts() {
        for part in [1.02, 1.04] {
            let expected = [false, false, true, true, false, false];
            assert_eq!(beside(&[1.0, 1.0, part, 1.06, 1.06, 1.06]), expected, "{part}");
        }
    }

    #[test]
    fn slow_or_small_changes_and_noise_are_not_steps() {
        assert!(!beside(&[1.0, 1.016, 1.0]).contains(&true));
        assert!(!beside(&std::array::from_fn::<_, 50, _>(|k| 1.0 + 0.015 * k as f64)).contains(&true));
        assert!(!states([1.0, 1.05, 0.98], 0.011).iter().any(|(power, _)| *power == Power::Step));
        let unsteady = states([1.0, 1.0025, 1.01], 1e-3);
        assert_eq!(unsteady[1], (Power::Steady, Doubt::default()));
        assert_eq!(unsteady[2].0, Power::Unsteady);
        assert!((unsteady[2].1.step - 0.0075 / 1.0025).abs() < 1e-12);
    }

    #[test]
    fn after_an_interruption_the_first_sample_is_not_compared() {
        let (mut steps, mut history) = (PowerSteps::default(), PowerHistory::default());
        steps.push(1.0, 1e-6, &mut history);
        steps.interrupt(&mut history);
        let states = [2.0, 2.2].map(|total| steps.push(total, 1e-6, &mut history).0);
        assert_eq!(states, [Power::Steady, Power::Step]);
    }

    #[test]
    fn a_lasting_change_without_a_pattern_becomes_usual() {
        let mut random = 1_u64;
        let totals = std::iter::repeat_with(|| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            1.0 + 0.2 * ((random >> 33) as f64 / f64::from(1_u32 << 31) - 0.5)
        });
        let states = states(totals.take(300), 1e-4);
        let steps = |states: &[(Power, Doubt)]| states.iter().filter(|(p, _)| *p == Power::Step).count();
        assert!(steps(&states[..20]) > 4, "{states:?}");
        assert_eq!(steps(&states[100..]), 0, "{states:?}");
    }

    #[test]
    fn flicker_is_no_step_once_it_is_known_and_a_step_within_it_still_is_one() {
        let flicker = |k: i32| 1.0 + 0.2 * (0.628 * f64::from(k)).sin();
        let stepped = |k: i32| flicker(k) * if k < 300 { 1.0 } else { 1.1 };
        let states = states((0..400).map(stepped), 1e-3);
        let at =
            |from: usize, to: usize| (from..to).filter(|k| states[*k].0 == Power::Step).collect::<Vec<_>>();
        assert!((1..30).contains(&at(0, 300).len()), "{:?}", at(0, 300));
        assert_eq!(at(40, 300), [0; 0]);
        assert!(at(300, 400).first() == Some(&300) && at(310, 400).is_empty(), "{:?}", at(300, 400));
        // The error of an interpolation is known: 0.2 * (2 sin(0.314))^2.
        let curves: Vec<_> = states[100..290].iter().map(|(_, doubt)| doubt.second_difference).collect();
        assert!(curves.iter().all(|curve| (0.03..0.1).contains(curve)), "{curves:?}");
    }
}
