//! The variance of signals by their second differences.
//!
//! Second differences `x[k+1] - 2 x[k] + x[k-1]` cancel a steady motion; for white noise their mean square is
//! six times the variance.

use serde::{Deserialize, Serialize};

/// Averaging lengths in samples: one for a burst, one for slow growth.
pub const WINDOWS: [f64; 2] = [64.0, 4096.0];

/// Running variances of `N` signals, in the square of their units. The number of second differences is kept by the
/// owner, because recordings contain it apart.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound(
    serialize = "[f64; N]: Serialize, [[f64; 2]; N]: Serialize",
    deserialize = "[f64; N]: Deserialize<'de>, [[f64; 2]; N]: Deserialize<'de>"
))]
pub struct SecondDifferences<const N: usize> {
    last: Option<[f64; N]>,
    last_step: Option<[f64; N]>,
    variance: [[f64; WINDOWS.len()]; N],
}

impl<const N: usize> Default for SecondDifferences<N> {
    fn default() -> Self {
        Self { last: None, last_step: None, variance: [[0.0; WINDOWS.len()]; N] }
    }
}

impl<const N: usize> SecondDifferences<N> {
    /// Forgets the last samples (there was a gap), but not the variances.
    pub fn interrupt(&mut self) {
        (self.last, self.last_step) = (None, None);
    }

    /// Takes the next sample, and counts its second differences in `count`. Returns the variance by each of them
    /// alone; `None` for the first two samples.
    pub fn push(&mut self, signals: [f64; N], count: &mut f64) -> Option<[f64; N]> {
        let step: Option<[f64; N]> = self.last.map(|last| std::array::from_fn(|i| signals[i] - last[i]));
        let single = step.zip(self.last_step).map(|(step, last_step)| {
            *count += 1.0;
            let single: [f64; N] = std::array::from_fn(|i| (step[i] - last_step[i]).powi(2) / 6.0);
            for (variances, square) in self.variance.iter_mut().zip(single) {
                for (variance, window) in variances.iter_mut().zip(WINDOWS) {
                    *variance += (square - *variance) / count.min(window);
                }
            }
            single
        });
        (self.last, self.last_step) = (Some(signals), step);
        single
    }

    /// The variance of a signal over each of the [`WINDOWS`].
    pub fn variance(&self, signal: usize) -> [f64; WINDOWS.len()] {
        self.variance[signal]
    }
}
