//! Whether the mirror is at rest, from the spots of consecutive samples.
//!
//! The noise of each spot coordinate is taken from its second differences, which a slow motion does not enter. At
//! rest, a coordinate neither drifts nor scatters by more than this noise explains.

use std::fmt;

use trifacet_optics::FACETS;

/// Fewest samples that can be judged.
pub const FEWEST: usize = 64;
/// A drift counts as motion beyond this number of its standard uncertainties: once in a million windows.
const DRIFT_SIGMAS: f64 = 5.0;
/// A scatter counts as motion if it exceeds the noise by this factor.
const SCATTER: f64 = 1.4;

/// The motion of a spot coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Index of the coordinate: u and v of A, B, C.
    pub signal: usize,
    /// What exceeds the noise.
    pub kind: MotionKind,
    /// Its amount, metres.
    pub amount: f64,
    /// The largest amount that noise explains, metres.
    pub allowed: f64,
}

/// Kinds of motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionKind {
    /// The coordinate moves in one direction.
    Drift,
    /// The coordinate moves to and fro.
    Scatter,
}

impl fmt::Display for Motion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (psd, axis) = (FACETS[self.signal / 2], ["u", "v"][self.signal % 2]);
        let [amount, allowed] = [self.amount, self.allowed].map(|metres| metres * 1e6);
        let what = match self.kind {
            MotionKind::Drift => "drifts",
            MotionKind::Scatter => "vibrates",
        };
        write!(f, "{axis} of PSD {psd} {what} by {amount:.2} um, where noise explains {allowed:.2} um")
    }
}

/// The strongest motion among the six coordinates of consecutive samples; `None` at rest. `steps`: the smallest
/// difference of readings of each coordinate, metres.
pub fn motion(spots: &[[f64; 6]], steps: &[f64; 6]) -> Option<Motion> {
    let excess = |motion: &Motion| motion.amount / motion.allowed;
    let motions = (0..6).flat_map(|signal| of_signal(spots, signal, steps[signal]));
    motions.filter(|m| excess(m) > 1.0).max_by(|a, b| excess(a).total_cmp(&excess(b)))
}

/// Drift and scatter of one coordinate.
fn of_signal(spots: &[[f64; 6]], signal: usize, step: f64) -> [Motion; 2] {
    let at = |k: usize| spots[k][signal];
    let n = spots.len() as f64;
    let seconds = (2..spots.len()).map(|k| (at(k) - 2.0 * at(k - 1) + at(k - 2)).powi(2));
    // A converter without noise repeats a code: its step is then all that is known of the noise.
    let noise = (seconds.sum::<f64>() / (6.0 * (n - 2.0))).sqrt().max(step / 12_f64.sqrt());
    let (middle, mean) = ((n - 1.0) / 2.0, (0..spots.len()).map(at).sum::<f64>() / n);
    let lever = |k: usize| k as f64 - middle;
    let squares: f64 = (0..spots.len()).map(|k| lever(k).powi(2)).sum();
    let slope = (0..spots.len()).map(|k| lever(k) * (at(k) - mean)).sum::<f64>() / squares;
    let rest: f64 = (0..spots.len()).map(|k| (at(k) - mean - slope * lever(k)).powi(2)).sum();
    let scatter = (rest / (n - 2.0)).sqrt();
    [
        Motion {
            signal,
            kind: MotionKind::Drift,
            amount: (slope * n).abs(),
            allowed: DRIFT_SIGMAS * noise * (12.0 / n).sqrt(),
        },
        Motion { signal, kind: MotionKind::Scatter, amount: scatter, allowed: SCATTER * noise },
    ]
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64;

    use super::*;

    const STEPS: [f64; 6] = [0.05e-6; 6];

    /// Samples with a noise of 1 um, and a motion of v of PSD B as a function of the sample.
    fn samples(n: usize, seed: u64, moves: impl Fn(f64) -> f64) -> Vec<[f64; 6]> {
        let (mut rng, noise) = (Pcg64::seed_from_u64(seed), Normal::new(0.0, 1e-6).unwrap());
        let sample = |k| {
            let mut spots: [f64; 6] = std::array::from_fn(|_| noise.sample(&mut rng));
            spots[3] += moves(k as f64);
            spots
        };
        (0..n).map(sample).collect()
    }

    #[test]
    fn noise_alone_is_rest() {
        for n in [FEWEST, 128, 1000] {
            let moving =
                (0..500).filter(|seed| motion(&samples(n, *seed, |_| 0.0), &STEPS).is_some()).count();
            assert!(moving <= if n == FEWEST { 5 } else { 1 }, "{n}: {moving}");
        }
    }

    #[test]
    fn a_drift_and_a_vibration_are_named_with_their_psd() {
        let drift = motion(&samples(128, 1, |k| 0.05e-6 * k), &STEPS).unwrap();
        assert_eq!((drift.signal, drift.kind), (3, MotionKind::Drift));
        assert!((drift.amount / 6.4e-6 - 1.0).abs() < 0.15, "{drift}");
        assert!(drift.to_string().starts_with("v of PSD B drifts by 6."), "{drift}");
        let shake = motion(&samples(128, 1, |k| 4e-6 * (k / 3.0).sin()), &STEPS).unwrap();
        assert_eq!((shake.signal, shake.kind), (3, MotionKind::Scatter));
        assert!(shake.to_string().starts_with("v of PSD B vibrates by 2."), "{shake}");
    }

    #[test]
    fn readings_without_noise_are_rest_and_a_change_beyond_a_step_is_not() {
        let still = |moves: &dyn Fn(usize) -> f64| -> Vec<[f64; 6]> {
            (0..128).map(|k| [1e-3, 0.0, 0.0, moves(k), 0.0, 0.0]).collect()
        };
        assert_eq!(motion(&still(&|_| 0.0), &STEPS), None);
        assert!(motion(&still(&|k| if k < 64 { 0.0 } else { 1e-6 }), &STEPS).is_some());
    }
}
