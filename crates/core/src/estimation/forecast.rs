//! Predicts the next change of the total power from the last ones.
//!
//! The light of lamps and of lasers on a mains supply flickers periodically. Such a power changes as much from sample
//! to sample as at a step, but it is predictable: a sine follows from its last values. The weights of the last
//! changes are a least-squares fit to the last samples.

use nalgebra::{Matrix4, Vector4};
use serde::{Deserialize, Serialize};

/// Number of changes in a prediction: two sines, a fundamental and a harmonic.
const ORDER: usize = 4;
/// The fit forgets with this averaging length, samples.
const WINDOW: f64 = 64.0;
/// Relative change of the power above which all samples have the same weight in the fit: one step does not dominate
/// it. Smaller changes (noise) have less weight.
const FULL_WEIGHT: f64 = 0.01;
/// Added to the normal equations, in which a full sample counts 1: without changes nothing is predicted.
const RIDGE: f64 = 0.01;

/// The fit, and the last changes.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Forecast {
    /// The last changes of the total, the newest one first.
    changes: Vector4<f64>,
    /// Number of known changes.
    known: u8,
    /// The normal equations.
    products: Matrix4<f64>,
    targets: Vector4<f64>,
}

/// A predicted change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// The change of the total, in the unit of the total.
    pub change: f64,
    /// Standard uncertainty of the difference between total and prediction, in units of that of one total.
    pub sigma: f64,
}

impl Forecast {
    /// The next total does not follow the last one. What was learnt remains.
    pub fn interrupt(&mut self) {
        self.known = 0;
    }

    /// The next change; `None` until enough changes are known.
    pub fn next(&self) -> Option<Expected> {
        if usize::from(self.known) < ORDER {
            return None;
        }
        let ridge = Matrix4::from_diagonal_element(RIDGE);
        let weights = (self.products + ridge).cholesky()?.solve(&self.targets);
        // The prediction error as a sum of totals, newest first: 1, -(1 + w1), w1 - w2, ..., w4.
        let mut squares = 1.0 + (1.0 + weights[0]).powi(2) + weights[ORDER - 1].powi(2);
        for k in 1..ORDER {
            squares += (weights[k - 1] - weights[k]).powi(2);
        }
        Some(Expected { change: weights.dot(&self.changes), sigma: squares.sqrt() })
    }

    /// Takes the change to a new total.
    pub fn learn(&mut self, change: f64, total: f64) {
        if usize::from(self.known) == ORDER {
            let least = FULL_WEIGHT * total;
            let weight = 1.0 / (least * least + self.changes.norm_squared());
            let keep = 1.0 - 1.0 / WINDOW;
            self.products = self.products * keep + self.changes * self.changes.transpose() * weight;
            self.targets = self.targets * keep + self.changes * (change * weight);
        }
        self.skip(change);
    }

    /// Takes a change that says nothing about the next ones.
    pub fn skip(&mut self, change: f64) {
        self.known = self.known.saturating_add(1).min(ORDER as u8);
        self.changes = Vector4::new(change, self.changes[0], self.changes[1], self.changes[2]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The largest error of the last half of the predictions.
    fn worst(total: impl Fn(f64) -> f64, samples: u32) -> f64 {
        let mut forecast = Forecast::default();
        let mut worst = 0.0_f64;
        for k in 1..samples {
            let (now, last) = (total(f64::from(k)), total(f64::from(k - 1)));
            if let Some(expected) = forecast.next().filter(|_| k > samples / 2) {
                worst = worst.max((now - last - expected.change).abs());
            }
            forecast.learn(now - last, now);
        }
        worst
    }

    #[test]
    fn a_sine_and_its_harmonic_are_predicted_after_forty_samples() {
        let sine = |part: f64, k: f64| (std::f64::consts::TAU * part * k).sin();
        for part in [0.01, 0.1, 0.123, 0.3, 0.45] {
            let error = worst(|k| 1.0 + 0.05 * sine(part, k), 80);
            assert!(error < 1e-3, "{part}: {error}");
        }
        let error = worst(|k| 1.0 + 0.05 * sine(0.1, k) + 0.02 * sine(0.2, k), 80);
        assert!(error < 2e-3, "{error}");
    }

    #[test]
    fn a_constant_power_is_predicted_to_remain_constant() {
        assert_eq!(worst(|_| 1.0, 1000), 0.0);
    }

    #[test]
    fn nothing_is_predicted_across_an_interruption() {
        let mut forecast = Forecast::default();
        (0..10).for_each(|k| forecast.learn(0.01 * f64::from(k % 2), 1.0));
        assert!(forecast.next().is_some());
        forecast.interrupt();
        assert_eq!(forecast.next(), None);
    }
}
