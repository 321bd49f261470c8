//! Positions of beam and stage in a sample.

use trifacet_core::signals::{PsdState, Sample};
use trifacet_core::steering::{BeamOffset, BeamPoint, StagePosition};
use trifacet_core::time::Mono;
use trifacet_optics::{Estimator, FACETS, HeadError, Model, Signals, Solution, SolveError};

use crate::config::Config;

/// Positions in a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Index of the sample.
    pub index: u64,
    /// Time of the sample.
    pub time: Mono,
    /// Position of the beam relative to the apex, perpendicular to the beam, metres.
    pub offset: BeamOffset,
    /// Position of the beam in the world, perpendicular to itself, metres. The mirror's movement has no
    /// effect on it.
    pub beam: BeamPoint,
    /// Total power, watts.
    pub power: f64,
    /// Position of the stage by its readback, metres.
    pub readback: Option<StagePosition>,
}

/// Why a sample cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ObservationError {
    /// No light at all.
    #[error("no PSD sees light")]
    NoLight,
    /// Too little light on a PSD.
    #[error("PSD {psd} sees too little light")]
    LittleLight {
        /// A, B or C.
        psd: char,
    },
    /// A channel reads the limit of its range.
    #[error("a channel of PSD {psd} is clipped")]
    Clipped {
        /// A, B or C.
        psd: char,
    },
    /// A channel repeats the same code.
    #[error("a channel of PSD {psd} repeats the same code")]
    Frozen {
        /// A, B or C.
        psd: char,
    },
    /// The stage cannot move further.
    #[error("the stage is at its own limit")]
    StageLimit,
    /// The signals belong to no pose.
    #[error("no pose can be computed: {0}")]
    NoPose(#[from] SolveError),
}

/// Evaluates samples with the Gaussian model, whatever is configured: the ray model has no beam offset.
#[derive(Clone, Debug)]
pub struct Observer {
    estimator: Estimator,
    warm: Option<Solution>,
}

impl Observer {
    /// An observer for the head of a checked configuration.
    ///
    /// # Errors
    /// The head cannot be built.
    pub fn new(config: &Config) -> Result<Self, HeadError> {
        Ok(Self { estimator: Estimator::new(config.optics()?, Model::Gaussian), warm: None })
    }

    /// Standard deviation of the beam profile per axis, metres.
    pub fn beam_sigma(&self) -> f64 {
        self.estimator.optics().sigma()
    }

    /// Evaluates a sample.
    ///
    /// # Errors
    /// The reason for which the sample cannot be used: too little light, clipping, no solution, or a stage at
    /// its own limit.
    pub fn look(&mut self, sample: &Sample) -> Result<Observation, ObservationError> {
        if sample.psds.iter().all(|state| *state == PsdState::Low) {
            return Err(ObservationError::NoLight);
        }
        for (state, psd) in sample.psds.iter().zip(FACETS) {
            match state {
                PsdState::Good => {}
                PsdState::Low => return Err(ObservationError::LittleLight { psd }),
                PsdState::Clipped => return Err(ObservationError::Clipped { psd }),
                PsdState::Frozen => return Err(ObservationError::Frozen { psd }),
            }
        }
        if sample.output_railed {
            return Err(ObservationError::StageLimit);
        }
        let signals = Signals { spots: sample.spots, powers: sample.powers };
        let solution = self.estimator.solve(&signals, self.warm.as_ref())?;
        let offset = solution.offset;
        let beam = self.estimator.optics().across(solution.pose.t) + offset;
        self.warm = Some(solution);
        Ok(Observation {
            index: sample.index,
            time: sample.time,
            offset: offset.into(),
            beam: beam.into(),
            power: sample.powers.iter().sum(),
            readback: sample.steering.filter(|at| at.iter().all(|p| p.is_finite())).map(StagePosition),
        })
    }
}

/// Mean of points of one kind; `None` without any.
pub fn mean<P: Into<[f64; 2]> + From<[f64; 2]>>(points: impl IntoIterator<Item = P>) -> Option<P> {
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for point in points.into_iter().map(Into::<[f64; 2]>::into) {
        sum = [sum[0] + point[0], sum[1] + point[1]];
        count += 1.0;
    }
    (count > 0.0).then(|| sum.map(|s| s / count).into())
}

/// Whether no sample is missing between these.
pub fn whole(looks: &[Observation]) -> bool {
    looks.first().zip(looks.last()).is_some_and(|(a, b)| b.index - a.index + 1 == looks.len() as u64)
}

/// Standard deviation of the white noise per axis, from second differences (their variance is 6 times that of
/// the noise). Slow movement has little effect on it. `None` below three points.
pub fn noise<P: Copy + Into<[f64; 2]>>(points: &[P]) -> Option<[f64; 2]> {
    let points: Vec<[f64; 2]> = points.iter().map(|p| (*p).into()).collect();
    let bend = |w: &[[f64; 2]], k: usize| (w[0][k] - 2.0 * w[1][k] + w[2][k]).powi(2) / 6.0;
    let count = points.len().checked_sub(2).filter(|n| *n > 0)? as f64;
    Some([0, 1].map(|k| (points.windows(3).map(|w| bend(w, k)).sum::<f64>() / count).sqrt()))
}

/// Rms residual from straight lines, each fitted to `samples` points, of the worse axis, metres. Contains
/// noise and vibration.
pub fn unrest<P: Copy + Into<[f64; 2]>>(points: &[P], samples: usize) -> f64 {
    let points: Vec<[f64; 2]> = points.iter().map(|p| (*p).into()).collect();
    let mut worst: f64 = 0.0;
    for axis in 0..2 {
        let (mut squares, mut count) = (0.0, 0_usize);
        for window in points.chunks_exact(samples) {
            let n = samples as f64;
            let at = |i: usize| i as f64 - (n - 1.0) / 2.0;
            let middle = window.iter().map(|p| p[axis]).sum::<f64>() / n;
            let length: f64 = (0..samples).map(|i| at(i).powi(2)).sum();
            let slope = window.iter().enumerate().map(|(i, p)| at(i) * p[axis]).sum::<f64>() / length;
            squares += window
                .iter()
                .enumerate()
                .map(|(i, p)| (p[axis] - middle - slope * at(i)).powi(2))
                .sum::<f64>();
            count += samples - 2;
        }
        worst = worst.max((squares / count.max(1) as f64).sqrt());
    }
    worst
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    use super::*;

    #[test]
    fn noise_excludes_slow_movement_and_unrest_includes_vibration() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(5);
        let course = |shake: f64, random: &mut rand_pcg::Pcg64| -> Vec<[f64; 2]> {
            let draw = |k: i32, random: &mut rand_pcg::Pcg64| {
                let t = f64::from(k) * 1e-3;
                let moved = 30e-6 * t + shake * (t * 400.0).sin();
                [moved + 0.1e-6 * random.sample::<f64, _>(StandardNormal), moved]
            };
            (0..3000).map(|k| draw(k, random)).collect()
        };
        let still = course(0.0, &mut random);
        let [x, y] = noise(&still).unwrap();
        assert!((x / 0.1e-6 - 1.0).abs() < 0.05 && y < 1e-12, "{x} {y}");
        assert!((unrest(&still, 75) / 0.1e-6 - 1.0).abs() < 0.05);
        let shaken = course(10e-6, &mut random);
        assert!((unrest(&shaken, 75) / 7.1e-6 - 1.0).abs() < 0.1, "{}", unrest(&shaken, 75));
        assert_eq!(noise(&still[..2]), None);
    }
}
