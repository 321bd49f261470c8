//! Steps of the power as version 0.1.0 judged them. A replay of its recordings gives the same poses, bit by bit.

use super::power_step::{Power, PowerSteps};

/// Relative change of the total: a step of 5 % that only one of three powers shows in the first scan.
const LIMIT: f64 = 0.05 / 3.0;
/// The change must also exceed this many standard uncertainties of the difference of two totals.
const SIGNIFICANT: f64 = 5.0;
/// A change beyond this many standard uncertainties makes the power unsteady.
const UNSTEADY: f64 = 4.0;
/// A step affects at most this many samples.
const LONGEST: u32 = 4;

impl PowerSteps {
    /// Compares the total power of a sample with the last two. `sigma` is its standard uncertainty.
    pub(super) fn push_as_in_0_1(&mut self, total: f64, sigma: f64) -> Power {
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

    /// Whether the power changes for longer than a step does.
    pub(super) fn lasting_as_in_0_1(&self) -> bool {
        self.row > LONGEST
    }
}
