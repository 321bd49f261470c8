//! The present noise of the signals.
//!
//! Second differences `x[k+1] - 2 x[k] + x[k-1]` cancel a steady motion; for white noise their mean square is
//! six times the variance. They therefore show the noise while the mirror moves. What remains of a fast
//! motion counts as noise, so that the stated uncertainties are too large rather than too small.

use serde::{Deserialize, Serialize};

use super::second_differences::{SecondDifferences, WINDOWS};

/// Number of monitored signals.
const SIGNALS: usize = 9;
/// The first signals are the spot coordinates. Most noise (laser, vibration) affects all of them, and their
/// mean shows it within fewer samples.
const SPOTS: usize = 6;
/// Averaging length for noise of all spots, samples.
const COMMON_WINDOW: f64 = 16.0;
/// A live standard uncertainty counts if it exceeds the configured one by this many of its own standard
/// uncertainties. In a hundred thousand samples of the configured noise none does so by chance.
const SIGNIFICANT: f64 = 4.0;

/// Live standard uncertainties of the nine signals.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct LiveNoise {
    differences: SecondDifferences<SIGNALS>,
    /// Mean variance of the spot coordinates.
    common: f64,
    count: f64,
}

impl LiveNoise {
    /// Forgets the last samples (there was a gap), but not the noise.
    pub fn interrupt(&mut self) {
        self.differences.interrupt();
    }

    /// Takes the next sample.
    pub fn push(&mut self, signals: [f64; SIGNALS]) {
        if let Some(single) = self.differences.push(signals, &mut self.count) {
            let mean = single[..SPOTS].iter().sum::<f64>() / SPOTS as f64;
            self.common += (mean - self.common) / self.count.min(COMMON_WINDOW);
        }
    }

    /// The standard uncertainty of a signal: the configured one, or the live one where it is significantly
    /// larger. An estimate from n second differences has a relative standard uncertainty of about 1/sqrt(n).
    pub fn sigma(&self, signal: usize, configured: f64) -> f64 {
        self.bounded(signal, configured, |_, _, variance| variance)
    }

    /// As [`sigma`](Self::sigma), where `bound` lowers the variance for a window, from the number of samples in it and
    /// the variance of the signal.
    pub fn bounded(&self, signal: usize, configured: f64, bound: impl Fn(usize, f64, f64) -> f64) -> f64 {
        let mut sigma = configured;
        let mut consider = |variance: f64, n: f64| {
            let live = variance.sqrt();
            if n > 0.0 && live > configured * (1.0 + SIGNIFICANT / n.sqrt()) {
                sigma = sigma.max(live);
            }
        };
        // Nearly always false; the bounds and the roots take longer.
        let larger = |variance: f64| variance > configured * configured;
        let own = self.differences.variance(signal).into_iter().zip(WINDOWS).enumerate();
        for (window, (variance, length)) in own {
            if larger(variance) {
                let n = self.count.min(length);
                consider(bound(window, n, variance), n);
            }
        }
        if signal < SPOTS && larger(self.common) {
            consider(self.common, self.count.min(COMMON_WINDOW) * SPOTS as f64);
        }
        sigma
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    use super::*;

    fn fed(sigma: f64, n: usize, movement: impl Fn(f64) -> f64) -> LiveNoise {
        let mut random = rand_pcg::Pcg64::seed_from_u64(3);
        let mut noise = LiveNoise::default();
        for k in 0..n {
            let draw = |_| movement(k as f64) + sigma * random.sample::<f64, _>(StandardNormal);
            noise.push([0; SIGNALS].map(draw));
        }
        noise
    }

    #[test]
    fn the_configured_noise_is_used_while_the_actual_noise_is_not_larger() {
        let noise = fed(1.0, 20_000, |k| 5.0 * k);
        for signal in 0..SIGNALS {
            assert_eq!(noise.sigma(signal, 1.0), 1.0);
        }
    }

    #[test]
    fn larger_noise_raises_the_estimate_to_its_value() {
        let noise = fed(1.5, 20_000, |k| 5.0 * k);
        for signal in 0..SIGNALS {
            let live = noise.sigma(signal, 1.0);
            assert!((1.45..2.2).contains(&live), "{live}"); // sigma of the short window: an eighth
        }
    }

    #[test]
    fn a_burst_is_detected_within_the_short_window() {
        let mut noise = fed(1.0, 5000, |_| 0.0);
        for k in 0..64 {
            noise.push([f64::from(k % 2) * 20.0; SIGNALS]);
        }
        assert!(noise.sigma(0, 1.0) > 8.0);
    }

    #[test]
    fn a_gap_does_not_raise_the_noise() {
        let mut noise = fed(0.1, 100, |_| 0.0);
        noise.interrupt();
        noise.push([1e6; SIGNALS]);
        noise.push([1e6; SIGNALS]);
        noise.push([1e6; SIGNALS]);
        assert_eq!(noise.sigma(0, 0.2), 0.2);
    }
}
