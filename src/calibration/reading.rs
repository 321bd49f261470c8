//! The reading of a point: means of the nine signals over consecutive samples at rest.

use trifacet_core::channels::{Amplifier, Channels};
use trifacet_core::signals::{Identity, PsdState, Sample};
use trifacet_core::time::Mono;
use trifacet_optics::FACETS;
use trifacet_wire::LockState;

/// A sample as the calibration sees it: before correction tables and power gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawSample {
    /// Time of the sample.
    pub time: Mono,
    /// u, v of A, B, C, metres.
    pub spots: [f64; 6],
    /// Powers on A, B, C before their gains, watts.
    pub powers: [f64; 3],
    /// Position of the stage: its readback, or what it reports, metres.
    pub stage: Option<[f64; 2]>,
    /// Why the sample does not count, if it does not.
    pub flaw: Option<Flaw>,
}

/// Why a sample does not count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Flaw {
    /// Samples before it are missing.
    #[error("samples are lost before it reaches the daemon")]
    Gap,
    /// Too little light on a PSD.
    #[error("PSD {0} receives too little light")]
    Dark(char),
    /// A channel reads the limit of its range.
    #[error("a channel of PSD {0} is clipped")]
    Clipped(char),
    /// A channel repeats the same code.
    #[error("a channel of PSD {0} repeats the same code")]
    Frozen(char),
    /// The stage is at its own limit.
    #[error("the steering is at its own limit")]
    StageLimit,
    /// The beam is not on the apex.
    #[error("the loop is {}: the beam is not on the apex", .0.name())]
    NotLocked(LockState),
}

impl Flaw {
    /// The flaw of a sample, with the state of the loop after it.
    pub fn of(sample: &Sample, lock: LockState) -> Option<Self> {
        for (state, psd) in sample.psds.iter().zip(FACETS) {
            match state {
                PsdState::Good => {}
                PsdState::Low => return Some(Self::Dark(psd)),
                PsdState::Clipped => return Some(Self::Clipped(psd)),
                PsdState::Frozen => return Some(Self::Frozen(psd)),
            }
        }
        if sample.output_railed {
            return Some(Self::StageLimit);
        }
        if lock != LockState::Locked {
            return Some(Self::NotLocked(lock));
        }
        (sample.lost > 0).then_some(Self::Gap)
    }

    /// Whether samples before and after it belong to different states of the head.
    pub fn interrupts(self) -> bool {
        self != Self::Gap
    }
}

/// The smallest differences of readings: one step of the converter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Steps {
    /// Of the spots, metres.
    pub spots: [f64; 6],
    /// Of the powers, watts.
    pub powers: [f64; 3],
}

impl Steps {
    /// The steps of a source, for a PSD that receives a third of the light in the middle of the range.
    pub fn new(channels: &Channels, source: &Identity) -> Self {
        let (volts, middle_v) = (source.converter.step_v(), source.converter.range_v / 2.0);
        let spots = std::array::from_fn(|i| {
            let psd = &channels.psds[i / 2];
            let unit = match psd.amplifier {
                Amplifier::Normalised => psd.full_scale_v,
                Amplifier::Difference => middle_v,
            };
            (volts * psd.gain[i % 2] / unit * psd.half_size).abs()
        });
        Self { spots, powers: [volts * channels.watts_per_volt; 3] }
    }
}

/// Means at a point, with the standard uncertainties of the means from the scatter of the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Time of the first sample.
    pub time: Mono,
    /// u, v of A, B, C, metres.
    pub spots: [f64; 6],
    /// Their standard uncertainties.
    pub spot_sigmas: [f64; 6],
    /// Powers on A, B, C, watts.
    pub powers: [f64; 3],
    /// Their standard uncertainties.
    pub power_sigmas: [f64; 3],
    /// Position of the stage, if every sample has one.
    pub stage: Option<[f64; 2]>,
    /// Number of samples.
    pub samples: u32,
    /// Number of samples that were left out.
    pub left_out: u32,
}

impl Reading {
    /// The means of these samples; `None` for fewer than two.
    pub fn new(samples: &[RawSample], steps: &Steps, left_out: u32) -> Option<Self> {
        let first = samples.first()?;
        if samples.len() < 2 {
            return None;
        }
        let spots = [0, 1, 2, 3, 4, 5].map(|i| mean(samples.iter().map(|s| s.spots[i]), steps.spots[i]));
        let powers = [0, 1, 2].map(|i| mean(samples.iter().map(|s| s.powers[i]), steps.powers[i]));
        let at: Option<Vec<[f64; 2]>> = samples.iter().map(|s| s.stage).collect();
        let stage = at.map(|at| [0, 1].map(|i| at.iter().map(|p| p[i]).sum::<f64>() / at.len() as f64));
        Some(Self {
            time: first.time,
            spots: spots.map(|(mean, _)| mean),
            spot_sigmas: spots.map(|(_, sigma)| sigma),
            powers: powers.map(|(mean, _)| mean),
            power_sigmas: powers.map(|(_, sigma)| sigma),
            stage,
            samples: samples.len() as u32,
            left_out,
        })
    }

    /// The largest standard uncertainty of a spot coordinate, metres.
    pub fn noise(&self) -> f64 {
        self.spot_sigmas.into_iter().fold(0.0, f64::max)
    }
}

/// The mean of numbers, and its standard uncertainty. Where the noise is less than a step, every number has the
/// same rounding, which averaging does not reduce.
fn mean(numbers: impl Iterator<Item = f64> + Clone, step: f64) -> (f64, f64) {
    let n = numbers.clone().count() as f64;
    let mean = numbers.clone().sum::<f64>() / n;
    let scatter = (numbers.map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    (mean, if scatter < step / 2.0 { step / 12_f64.sqrt() } else { scatter / n.sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(k: i64, u: f64, stage: Option<[f64; 2]>) -> RawSample {
        RawSample { time: Mono(k), spots: [u; 6], powers: [2e-4; 3], stage, flaw: None }
    }

    #[test]
    fn the_uncertainty_of_a_mean_is_its_scatter_or_the_rounding() {
        let steps = Steps { spots: [0.1e-6; 6], powers: [1e-9; 3] };
        let at = [1e-6, -1e-6, 3e-6, -3e-6].iter().zip(0..).map(|(u, k)| sample(k, *u, Some([*u, 1.0])));
        let reading = Reading::new(&at.collect::<Vec<_>>(), &steps, 3).unwrap();
        assert_eq!((reading.time, reading.samples, reading.left_out), (Mono(0), 4, 3));
        assert!(reading.spots[0].abs() < 1e-20 && reading.stage == Some([reading.spots[0], 1.0]));
        // The sum of squares is 20 um^2: the variance is 20/3, that of the mean 20/12.
        assert!((reading.spot_sigmas[5] - (20.0 / 12.0_f64).sqrt() * 1e-6).abs() < 1e-15);
        assert!((reading.power_sigmas[1] - 1e-9 / 12_f64.sqrt()).abs() < 1e-20);
        assert_eq!(reading.noise(), reading.spot_sigmas[0]);
        assert_eq!(Reading::new(&[sample(0, 0.0, None)], &steps, 0), None);
        let half = [sample(0, 0.0, Some([0.0; 2])), sample(1, 0.0, None)];
        assert_eq!(Reading::new(&half, &steps, 0).unwrap().stage, None);
    }
}
