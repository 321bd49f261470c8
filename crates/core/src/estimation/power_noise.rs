//! Bounds of the noise of a power that motion does not raise.
//!
//! In the second differences of a power, a vibration of the mirror that is fast at the sample rate counts as noise. The
//! sum of the three powers does not depend on the position of the beam, and its noise is at least that of each power. The
//! fraction of a power in the sum does not depend on the power of the laser, whose flicker does not change the pose; its
//! noise is at least that of this power, times the rest of the beam. Both are upper bounds of the noise of a power that
//! matters, and the smaller one is used.

use serde::{Deserialize, Serialize};

use super::second_differences::SecondDifferences;

/// The total, and the fractions on A, B and C.
const SIGNALS: usize = 4;

/// Noise of the sum of the powers and of their fractions.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct PowerNoise {
    differences: SecondDifferences<SIGNALS>,
    count: f64,
    /// The newest signals.
    newest: [f64; SIGNALS],
}

impl PowerNoise {
    /// Forgets the last sample (there was a gap), but not the noise.
    pub fn interrupt(&mut self) {
        self.differences.interrupt();
    }

    /// Takes the powers of the next sample.
    pub fn push(&mut self, powers: [f64; 3]) {
        let total: f64 = powers.iter().sum();
        let [a, b, c] = powers.map(|power| power / total);
        self.newest = [total, a, b, c];
        self.differences.push(self.newest, &mut self.count);
    }

    /// Upper bounds of the variance of a power from its last `count` samples: by the total, and by the fraction. `None`
    /// if fewer samples are known.
    pub fn bounds(&self, psd: usize, window: usize, count: f64) -> Option<[f64; 2]> {
        if count <= 0.0 || self.count < count {
            return None;
        }
        let [total, fractions @ ..] = self.newest;
        let by_fraction =
            self.differences.variance(1 + psd)[window] * (total / (1.0 - fractions[psd])).powi(2);
        Some([self.differences.variance(0)[window], by_fraction])
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    use super::*;
    use crate::estimation::second_differences::WINDOWS;

    /// The bounds of the standard uncertainties of A, B and C after samples with this noise on A, B and C. `light` gives
    /// the powers of a sample without noise.
    fn bounds(sigmas: [f64; 3], light: impl Fn(f64) -> [f64; 3]) -> [[f64; 2]; 3] {
        let mut random = rand_pcg::Pcg64::seed_from_u64(9);
        let mut noise = PowerNoise::default();
        for k in 0..20_000 {
            let powers = light(f64::from(k));
            noise.push([0, 1, 2].map(|i| powers[i] + sigmas[i] * random.sample::<f64, _>(StandardNormal)));
        }
        [0, 1, 2].map(|psd| noise.bounds(psd, 1, WINDOWS[1]).unwrap().map(f64::sqrt))
    }

    #[test]
    fn the_bounds_hold_for_equal_noise_and_for_noise_on_one_channel() {
        for sigmas in [[1e-3; 3], [1e-2, 1e-3, 1e-3], [1e-3, 0.0, 2e-3]] {
            for (psd, bounds) in bounds(sigmas, |_| [1.0, 0.7, 1.3]).into_iter().enumerate() {
                assert!(bounds.iter().all(|bound| *bound > 0.95 * sigmas[psd]), "{psd}: {bounds:?}");
            }
        }
        let [a, ..] = bounds([1e-2, 1e-3, 1e-3], |_| [1.0; 3]);
        assert!(a.iter().all(|bound| *bound < 1.05e-2), "the noisy channel itself is not overstated: {a:?}");
    }

    #[test]
    fn the_total_does_not_show_a_vibration_and_a_fraction_does_not_show_flicker() {
        let fast = |k: f64| (2.5 * k).sin();
        let vibrating =
            bounds([1e-3; 3], |k| [1.0 + 0.3 * fast(k), 1.0 - 0.1 * fast(k), 1.0 - 0.2 * fast(k)]);
        assert!(vibrating.iter().all(|[total, _]| (1.6e-3..1.9e-3).contains(total)), "{vibrating:?}");
        let flickering = bounds([1e-3; 3], |k| [1.0 + 0.3 * fast(k); 3]);
        // In fractions of a total that itself changes by 30 %.
        assert!(flickering.iter().all(|[_, own]| (0.8e-3..1.9e-3).contains(own)), "{flickering:?}");
    }

    #[test]
    fn nothing_is_known_of_more_samples_than_were_taken() {
        let mut noise = PowerNoise::default();
        (0..66).for_each(|_| noise.push([1.0; 3]));
        assert!(noise.bounds(0, 0, 64.0).is_some());
        assert_eq!(noise.bounds(0, 1, 65.0), None);
        assert_eq!(noise.bounds(0, 0, 0.0), None);
    }
}
