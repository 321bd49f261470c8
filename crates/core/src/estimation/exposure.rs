//! How a changing power of the laser enters the signals of a converter that samples one channel after the other.
//!
//! The channel map interpolates each channel linearly to the time of the scan. With the skew `s` (a part of the sampling
//! period), a power whose second difference is `D` is then wrong by `s (1 - s) / 2 * D`. Only the differences of these
//! errors matter: between two powers, and, for amplifiers that do not divide by the sum, between a position and its sum.
//! If all skews are equal, a changing power has no effect.

use serde::{Deserialize, Serialize};
use trifacet_optics::Noise;
use trifacet_wire::channel::Role;

use crate::channels::Amplifier;
use crate::signals::{Identity, Sample};

/// A change of the total power that only one of the three PSDs shows is this many times as large on that PSD.
pub const OF_ONE: f64 = 3.0;
/// The second difference of a sine at half the sample rate understates the error of the interpolation by this factor.
const FAST: f64 = 2.0;

/// What a changing power does to the signals of a source.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Exposure {
    /// A step of the power can be in some of the signals of a scan and not in others.
    steps: bool,
    /// Error of each power, per second difference of the power.
    powers: [f64; 3],
    /// Largest difference of the errors of two powers.
    ratio: f64,
    /// The same for a position and the sum that divides it: u, v of A, B, C. `None` if both are sampled together, or
    /// if the amplifier divides.
    positions: [Option<f64>; 6],
}

/// By how much the power changed in an unforeseen way, relative to the power.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Doubt {
    /// Change of the total that the last samples do not predict.
    pub step: f64,
    /// Second difference of the total: the largest one of the last samples.
    pub second_difference: f64,
}

impl Exposure {
    /// For the channels of a source with these amplifiers.
    pub fn new(identity: &Identity, amplifiers: [Amplifier; 3]) -> Self {
        let skew = |role: Role| {
            identity.place(role).and_then(|place| identity.skews().nth(place)).unwrap_or_default()
        };
        let sums = [0, 1, 2].map(|i| skew(Role::Sum(i)));
        let powers = sums.map(error);
        let mut positions = [None; 6];
        for (i, psd) in (0..3).zip(0_u8..).filter(|(i, _)| amplifiers[*i] == Amplifier::Difference) {
            for (k, at) in [Role::U(psd), Role::V(psd)].map(skew).into_iter().enumerate() {
                positions[2 * i + k] = (at != sums[i]).then(|| (error(at) - powers[i]).abs());
            }
        }
        let steps = sums.iter().any(|sum| *sum != sums[0]) || positions.iter().any(Option::is_some);
        let [least, most] = [f64::min, f64::max].map(|of| powers.into_iter().reduce(of).unwrap_or_default());
        Self { steps, powers, ratio: most - least, positions }
    }

    /// Whether a step of the power can be in some of the signals of a scan and not in others.
    pub fn to_steps(&self) -> bool {
        self.steps
    }

    /// Variance of the error of a power due to the interpolation, if the power has this variance by its second
    /// differences: because of a fast motion.
    pub fn variance(&self, psd: usize, by_differences: f64) -> f64 {
        6.0 * by_differences * (FAST * self.powers[psd]).powi(2)
    }

    /// Adds the uncertainty due to changes of the power.
    pub fn widen(&self, noise: &mut Noise, sample: &Sample, doubt: &Doubt) {
        if !self.steps || *doubt == Doubt::default() {
            return;
        }
        let relative = |per_difference: f64| {
            (OF_ONE * doubt.step).hypot(FAST * per_difference * doubt.second_difference)
        };
        for (sigma, power) in noise.powers.iter_mut().zip(sample.powers) {
            // A ratio has the uncertainty of two powers.
            *sigma = sigma.hypot(power * relative(self.ratio / std::f64::consts::SQRT_2));
        }
        for (i, sigma) in noise.spots.iter_mut().enumerate() {
            if let Some(error) = self.positions[i] {
                *sigma = sigma.hypot(sample.spots[i] * relative(error));
            }
        }
    }
}

/// Error of the interpolation to the time of the scan, per second difference.
fn error(skew: f64) -> f64 {
    skew * (1.0 - skew) / 2.0
}

impl Doubt {
    /// The sum of two.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            step: self.step + other.step,
            second_difference: self.second_difference + other.second_difference,
        }
    }

    /// The mean, if this is the sum of `count`.
    #[must_use]
    pub fn mean(self, count: u16) -> Self {
        let n = f64::from(count.max(1));
        Self { step: self.step / n, second_difference: self.second_difference / n }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signals::PsdState;
    use crate::time::Mono;

    fn identity(skew_ns: impl Fn(u32) -> u32) -> Identity {
        Identity { skew_ns: (0..9).map(skew_ns).collect(), ..Identity::example() }
    }

    fn widened(exposure: &Exposure, doubt: Doubt) -> Noise {
        let mut noise = Noise { spots: [0.0; 6], powers: [0.0; 3] };
        let sample = Sample {
            index: 0,
            time: Mono(0),
            time_sigma_ns: None,
            lost: 0,
            spots: [1e-3; 6],
            powers: [1.0; 3],
            psds: [PsdState::Good; 3],
            steering: None,
            output_railed: false,
            applied: None,
            uncovered: false,
        };
        exposure.widen(&mut noise, &sample, &doubt);
        noise
    }

    #[test]
    fn channels_that_are_sampled_together_do_not_mind_a_changing_power() {
        for skew_ns in [0, 50_000] {
            for amplifier in [Amplifier::Normalised, Amplifier::Difference] {
                let exposure = Exposure::new(&identity(|_| skew_ns), [amplifier; 3]);
                assert!(!exposure.to_steps());
                let noise = widened(&exposure, Doubt { step: 0.1, second_difference: 0.1 });
                assert_eq!((noise.spots, noise.powers), ([0.0; 6], [0.0; 3]));
            }
        }
    }

    #[test]
    fn the_error_of_a_ratio_is_that_of_the_interpolation() {
        // 1 kHz: the sums are sampled 4, 10 and 16 % of the period after the scan.
        let exposure = Exposure::new(&identity(|k| 20_000 * k), [Amplifier::Normalised; 3]);
        let noise = widened(&exposure, Doubt { step: 0.0, second_difference: 0.01 });
        let expected = 2.0 * 0.01 * (0.16 * 0.84 - 0.04 * 0.96) / 2.0 / 2.0_f64.sqrt();
        assert!(noise.powers.iter().all(|sigma| (sigma - expected).abs() < 1e-12), "{noise:?}");
        assert_eq!(noise.spots, [0.0; 6]);
        let noise = widened(&exposure, Doubt { step: 0.01, second_difference: 0.0 });
        assert_eq!(noise.powers, [OF_ONE * 0.01; 3]);
    }

    #[test]
    fn a_position_that_is_not_divided_by_its_sum_is_exposed_too() {
        let mixed = [Amplifier::Difference, Amplifier::Normalised, Amplifier::Normalised];
        let exposure = Exposure::new(&identity(|k| 20_000 * k), mixed);
        let noise = widened(&exposure, Doubt { step: 0.01, second_difference: 0.0 });
        assert_eq!(noise.spots, [3e-5, 3e-5, 0.0, 0.0, 0.0, 0.0]);
    }
}
