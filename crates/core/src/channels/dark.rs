//! Dark offsets: the readings of the nine channels with the laser off.

use trifacet_optics::FACETS;
use trifacet_wire::channel::SIGNALS;

use crate::signals::{Identity, Scan};

/// A sum signal above this many thresholds is light, not an offset.
const LIGHT: f64 = 10.0;

/// Names of the channels of a PSD in messages, in order.
const PARTS: [&str; 3] = ["u", "v", "sum"];

/// Running means of the nine channels over many scans.
#[derive(Clone, Debug)]
pub struct DarkOffsetEstimator {
    places: [usize; 9],
    step_v: f64,
    full_scale: i32,
    count: u32,
    /// Running mean and sum of squared differences from it, per channel, codes.
    means: [f64; 9],
    squares: [f64; 9],
}

/// Dark offsets of a head.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DarkOffsets {
    /// u, v, sum of A, B, C in volts.
    pub volts: [[f64; 3]; 3],
    /// Standard uncertainty of each mean, volts.
    pub sigma: [[f64; 3]; 3],
}

/// Reasons why there are no dark offsets.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DarkError {
    /// The source has no channel for one of the nine signals.
    #[error("the source has no channel for {0}")]
    Missing(String),
    /// A PSD sees light.
    #[error(
        "PSD {psd} sees light: its sum is {volts:.4} V, above the dark limit of {limit:.4} V; switch the laser off"
    )]
    Light {
        /// A, B or C.
        psd: char,
        /// Reading of its sum channel, volts.
        volts: f64,
        /// Largest reading in the dark, volts.
        limit: f64,
    },
    /// A channel is at its rail.
    #[error("the {part} channel of PSD {psd} is at the rail of the converter; check its amplifier")]
    Clipped {
        /// "u", "v" or "sum".
        part: &'static str,
        /// A, B or C.
        psd: char,
    },
}

impl DarkOffsetEstimator {
    /// An estimator without any scan.
    ///
    /// # Errors
    /// The source has no channel for one of the nine signals.
    pub fn new(identity: &Identity) -> Result<Self, DarkError> {
        let mut places = [0; 9];
        for (place, role) in places.iter_mut().zip(SIGNALS) {
            *place = identity.place(role).ok_or_else(|| DarkError::Missing(format!("{role:?}")))?;
        }
        let (step_v, full_scale) = (identity.converter.step_v(), identity.converter.full_scale());
        Ok(Self { places, step_v, full_scale, count: 0, means: [0.0; 9], squares: [0.0; 9] })
    }

    /// Number of scans so far.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// Adds a scan.
    ///
    /// # Errors
    /// A channel is at the rail of the converter.
    pub fn push(&mut self, scan: &Scan) -> Result<(), DarkError> {
        self.count += 1;
        for (i, place) in self.places.into_iter().enumerate() {
            let code = scan.codes[place];
            if code >= self.full_scale - 1 || code <= -self.full_scale {
                return Err(DarkError::Clipped { part: PARTS[i % 3], psd: FACETS[i / 3] });
            }
            let off = f64::from(code) - self.means[i];
            self.means[i] += off / f64::from(self.count);
            self.squares[i] += off * (f64::from(code) - self.means[i]);
        }
        Ok(())
    }

    /// The offsets, if no PSD sees light.
    ///
    /// # Errors
    /// The mean of a sum signal is above ten times `sum_threshold_v`.
    pub fn offsets(&self, sum_threshold_v: f64) -> Result<DarkOffsets, DarkError> {
        let n = f64::from(self.count);
        let volts = |i: usize| self.means[i] * self.step_v;
        let sigma = |i: usize| (self.squares[i] / (n * (n - 1.0).max(1.0))).sqrt() * self.step_v;
        let limit = LIGHT * sum_threshold_v;
        for (i, psd) in FACETS.into_iter().enumerate() {
            let volts = volts(3 * i + 2);
            if volts.abs() > limit {
                return Err(DarkError::Light { psd, volts, limit });
            }
        }
        let table = |f: &dyn Fn(usize) -> f64| [0, 1, 2].map(|p| [0, 1, 2].map(|k| f(3 * p + k)));
        Ok(DarkOffsets { volts: table(&volts), sigma: table(&sigma) })
    }
}
