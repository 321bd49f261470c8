use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::*;

const STEP: f64 = 20e-6;

/// Parameters of a loop, for a recording at 1 kHz of 60 steps.
#[derive(Clone, Copy, Debug)]
struct Truth {
    gain: [f64; 2],
    delay: f64,
    lag: f64,
    noise: f64,
    /// Drift of the mirror: amplitude in metres and frequency in hertz.
    drift: (f64, f64),
    /// Standard deviation of the delay, seconds.
    jitter: f64,
    seed: u64,
}

const TRUTH: Truth = Truth {
    gain: [0.7, -0.4],
    delay: 1.1e-3,
    lag: 0.5e-3,
    noise: 0.1e-6,
    drift: (40e-6, 0.11),
    jitter: 0.0,
    seed: 1,
};

fn recorded(truth: &Truth) -> Windows {
    let mut random = Pcg64::seed_from_u64(truth.seed);
    let times: Vec<f64> = (-24..=50).map(|k| f64::from(k) * 1e-3).collect();
    let window = |k: i32| {
        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
        let delay = truth.delay + truth.jitter * random.sample::<f64, _>(StandardNormal);
        let (drift, frequency) = truth.drift;
        let mut value = |t: &f64, gain: f64| {
            let wander = drift * ((f64::from(k) * 0.05 + t) * frequency * std::f64::consts::TAU).sin();
            let moved = (shape(*t, delay, truth.lag) - 0.5) * gain * STEP;
            moved + sign * (wander + truth.noise * random.sample::<f64, _>(StandardNormal))
        };
        times.iter().map(|t| [value(t, truth.gain[0]), value(t, truth.gain[1])]).collect()
    };
    let offsets = (0..60).map(window).collect();
    Windows { offsets, times, period: 1e-3, step: STEP }
}

fn near(found: f64, sigma: f64, truth: f64) {
    assert!((found - truth).abs() < 4.5 * sigma, "{found} +- {sigma}, truly {truth}");
}

/// Where a delay ends within some microseconds of a sample, the fit cannot see on which side: half a percent of the
/// sample period of 1 ms is not part of the stated uncertainty.
fn near_in_time(found: f64, sigma: f64, truth: f64) {
    assert!((found - truth).abs() < 4.5 * sigma + 10e-6, "{found} +- {sigma}, truly {truth}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]
    #[test]
    fn the_loop_is_identified_within_the_reported_standard_uncertainties(
        x in -2.0_f64..2.0, y in 0.3_f64..2.0, delay in 0.05_f64..8.0, lag in 0.4_f64..5.0, seed: u64,
    ) {
        let truth = Truth { gain: [x, y], delay: delay * 1e-3, lag: lag * 1e-3, seed, ..TRUTH };
        let found = fit(&recorded(&truth)).unwrap();
        near(found.gain[0], found.gain_sigma[0], x);
        near(found.gain[1], found.gain_sigma[1], y);
        near_in_time(found.delay, found.delay_sigma, truth.delay);
        near_in_time(found.lag, found.lag_sigma, truth.lag);
        prop_assert!(found.gain_sigma[0] < 2e-3 && found.delay_sigma < 0.1e-3 && found.lag_sigma < 0.2e-3, "{found:?}");
        prop_assert!(found.misfit < 0.02 && found.used >= 55, "{} {}", found.misfit, found.used);
    }
}

#[test]
fn the_reported_standard_uncertainties_are_right_on_average() {
    let mut squares = [0.0; 4];
    for seed in 0..100 {
        let found = fit(&recorded(&Truth { seed, ..TRUTH })).unwrap();
        let off = [
            (found.gain[0] - TRUTH.gain[0]) / found.gain_sigma[0],
            (found.gain[1] - TRUTH.gain[1]) / found.gain_sigma[1],
            (found.delay - TRUTH.delay) / found.delay_sigma,
            (found.lag - TRUTH.lag) / found.lag_sigma,
        ];
        squares = std::array::from_fn(|i| squares[i] + off[i] * off[i] / 100.0);
    }
    // 100 squared normalized errors: their mean is 1 with a standard deviation of 0.14.
    assert!(squares.iter().all(|s| (0.6..1.4).contains(s)), "{squares:?}");
}

#[test]
fn without_a_lag_the_delay_is_that_of_the_first_sample_that_has_moved() {
    for lag in [0.0, 0.02e-3] {
        let found = fit(&recorded(&Truth { delay: 2.3e-3, lag, ..TRUTH })).unwrap();
        assert_eq!(found.lag, 0.0);
        assert!((found.delay - 3e-3).abs() < 1e-12, "{}", found.delay);
        assert!((found.gain[0] - 0.7).abs() < 1e-3 && found.misfit < 0.01, "{found:?}");
    }
}

#[test]
fn jitter_is_found_and_very_late_steps_are_excluded() {
    let mut windows = recorded(&Truth { jitter: 0.2e-3, lag: 1.5e-3, ..TRUTH });
    let late = recorded(&Truth { delay: 9e-3, lag: 1.5e-3, seed: 2, ..TRUTH });
    for i in [3, 10, 11, 40] {
        windows.offsets[i].clone_from(&late.offsets[i]);
    }
    let found = fit(&windows).unwrap();
    assert!((4..8).contains(&found.outliers) && found.used == 60 - found.outliers, "{}", found.outliers);
    assert!((0.1e-3..0.3e-3).contains(&found.jitter), "{}", found.jitter);
    assert_eq!(found.unfollowed, 0);
    near(found.delay, found.delay_sigma + 0.02e-3, TRUTH.delay);
    let steady = fit(&recorded(&TRUTH)).unwrap();
    assert!(steady.jitter < 0.02e-3 && steady.unfollowed == 0, "{}", steady.jitter);
}

#[test]
fn a_ringing_stage_does_not_fit_and_a_stuck_one_has_no_gain() {
    let mut ringing = recorded(&Truth { lag: 1e-5, ..TRUTH });
    for window in &mut ringing.offsets {
        for (value, t) in window.iter_mut().zip(&ringing.times) {
            let since = t - TRUTH.delay;
            let ring = if since > 0.0 { 0.5 * (-since / 8e-3).exp() * (since * 1e3).cos() } else { 0.0 };
            *value = [0, 1].map(|k| value[k] + ring * TRUTH.gain[k] * STEP);
        }
    }
    assert!(fit(&ringing).unwrap().misfit > 0.15);
    let stuck = fit(&recorded(&Truth { gain: [0.0; 2], ..TRUTH })).unwrap();
    assert!(stuck.gain.iter().all(|g| g.abs() < 1e-2), "{stuck:?}");
}

#[test]
fn steps_without_response_are_counted() {
    let mut windows = recorded(&TRUTH);
    let still = recorded(&Truth { gain: [0.0; 2], seed: 2, ..TRUTH });
    windows.offsets[55..].clone_from_slice(&still.offsets[55..]);
    assert_eq!(fit(&windows).unwrap().unfollowed, 5);
}

#[test]
fn too_few_windows_give_nothing() {
    let mut windows = recorded(&TRUTH);
    windows.offsets.truncate(3);
    assert_eq!(fit(&windows), None);
    assert_eq!(fit(&Windows::default()), None);
}
