//! What a sample says of beam and stage.

use trifacet_core::signals::{PsdState, Sample};
use trifacet_core::steering::Xy;
use trifacet_core::time::Mono;
use trifacet_optics::{Estimator, FACETS, HeadError, Model, Optics, Signals, Solution};

use crate::config::Config;

/// What a sample says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// As in the sample.
    pub index: u64,
    /// As in the sample.
    pub time: Mono,
    /// Beam minus apex, across the beam, metres.
    pub offset: Xy,
    /// The beam in the world, across itself, metres: the mirror's movement is not in it.
    pub beam: Xy,
    /// Where the stage says that it stands, metres.
    pub readback: Option<Xy>,
}

/// Looks at samples with the Gaussian model, whatever the configuration has: the ray knows no offset.
#[derive(Clone, Debug)]
pub struct Observer {
    estimator: Estimator,
    warm: Option<Solution>,
}

impl Observer {
    /// For the head of a checked configuration.
    pub fn new(config: &Config) -> Result<Self, HeadError> {
        let optics = Optics::new(&config.head.build()?);
        Ok(Self { estimator: Estimator::new(optics, Model::Gaussian), warm: None })
    }

    /// One standard deviation of the beam, metres.
    pub fn beam_sigma(&self) -> f64 {
        self.estimator.optics().sigma()
    }

    /// Looks at a sample; the error says what is wrong with its light, or that the stage is at a limit.
    pub fn look(&mut self, sample: &Sample) -> Result<Observation, String> {
        if sample.psds.iter().all(|state| *state == PsdState::Low) {
            return Err("no PSD sees light".into());
        }
        for (state, psd) in sample.psds.iter().zip(FACETS) {
            match state {
                PsdState::Good => {}
                PsdState::Low => return Err(format!("PSD {psd} sees too little light")),
                PsdState::Clipped => return Err(format!("a channel of PSD {psd} is clipped")),
            }
        }
        if sample.output_railed {
            return Err("the stage stands at a limit of its own".into());
        }
        let signals = Signals { spots: sample.spots, powers: sample.powers };
        let solution = self
            .estimator
            .solve(&signals, self.warm.as_ref())
            .map_err(|error| format!("the light gives no pose: {error}"))?;
        let offset = solution.offset;
        let beam = self.estimator.optics().across(solution.pose.t) + offset;
        self.warm = Some(solution);
        Ok(Observation {
            index: sample.index,
            time: sample.time,
            offset: offset.into(),
            beam: beam.into(),
            readback: sample.steering.filter(|at| at.iter().all(|p| p.is_finite())),
        })
    }
}

/// Mean of points.
pub fn mean(points: impl IntoIterator<Item = Xy>) -> Option<Xy> {
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for point in points {
        sum = [sum[0] + point[0], sum[1] + point[1]];
        count += 1.0;
    }
    (count > 0.0).then(|| sum.map(|s| s / count))
}

/// No sample is lost between these.
pub fn whole(looks: &[Observation]) -> bool {
    looks.first().zip(looks.last()).is_some_and(|(a, b)| b.index - a.index + 1 == looks.len() as u64)
}

/// White noise of a course of points, one standard deviation per axis, by its second differences: slow
/// movement is not in it. `None` below three points.
pub fn noise(points: &[Xy]) -> Option<Xy> {
    let bend = |w: &[Xy], k: usize| (w[0][k] - 2.0 * w[1][k] + w[2][k]).powi(2) / 6.0;
    let count = points.len().checked_sub(2).filter(|n| *n > 0)? as f64;
    Some([0, 1].map(|k| (points.windows(3).map(|w| bend(w, k)).sum::<f64>() / count).sqrt()))
}

/// How far points are from a straight course over so many samples, rms of the worse axis, metres: noise
/// and whatever shakes.
pub fn unrest(points: &[Xy], samples: usize) -> f64 {
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
    fn noise_leaves_slow_movement_out_and_unrest_leaves_in_what_shakes() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(5);
        let course = |shake: f64, random: &mut rand_pcg::Pcg64| -> Vec<Xy> {
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
