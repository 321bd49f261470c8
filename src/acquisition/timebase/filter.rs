//! Offset and drift of the board's clock relative to the clock of the host, from arrivals.

use trifacet_core::time::NS_PER_S;

/// Standard uncertainty of the offset at the start, nanoseconds: the possible delay of a first arrival.
const FIRST_SIGMA_NS: f64 = 1e6;
/// Standard uncertainty of the drift at the start: cheap crystals are within 100 ppm.
const DRIFT_SIGMA: f64 = 100e-6;
/// Random walk of the drift (temperature), per square root of a second.
const DRIFT_WANDER: f64 = 0.05e-6;
/// Random walk of the offset, nanoseconds per square root of a second.
const OFFSET_WANDER_NS: f64 = 300.0;
/// Smallest standard uncertainty of the fastest arrival of a block, nanoseconds.
const ARRIVAL_SIGMA_NS: f64 = 500.0;
/// Smallest number of arrivals in a block: among this many, one is fast.
const BLOCK_ARRIVALS: u32 = 16;
/// Longest duration of a block that has enough arrivals, nanoseconds.
const BLOCK_NS: f64 = 0.25e9;
/// Early blocks last this fraction of the elapsed time, so that the filter converges quickly.
const BLOCK_PART: f64 = 0.25;
/// A block whose fastest arrival is later than predicted by this many standard uncertainties is rejected.
const GATE: f64 = 5.0;
/// After this many rejections in a row, and after this time, the delay itself has become longer. Early blocks are short:
/// all of them can lie within one pause of the host.
const REJECTED_IN_A_ROW: u32 = 8;
const REJECTED_NS: f64 = 2e9;

/// Offset and drift with their covariance.
#[derive(Clone, Debug)]
pub(super) struct Filter {
    /// Host time minus device time, from their common origin, nanoseconds.
    pub offset_ns: f64,
    /// Rate of the offset, nanoseconds per nanosecond.
    pub drift: f64,
    /// Variance of the offset, covariance, variance of the drift.
    pub variance: [f64; 3],
    refused: u32,
    /// Delay of the last block if it was refused, nanoseconds: either the host was busy and the offset is right,
    /// or the clock of the board is slow and the offset is wrong by this.
    pub doubt_ns: f64,
    /// Device time since the last accepted block, nanoseconds.
    since_ns: f64,
}

impl Default for Filter {
    fn default() -> Self {
        let variance = [FIRST_SIGMA_NS * FIRST_SIGMA_NS, 0.0, DRIFT_SIGMA * DRIFT_SIGMA];
        Self { offset_ns: 0.0, drift: 0.0, variance, refused: 0, doubt_ns: 0.0, since_ns: 0.0 }
    }
}

impl Filter {
    /// A filter that begins with this drift.
    pub fn with_drift(drift: f64) -> Self {
        Self { drift, ..Self::default() }
    }

    pub fn predict(&mut self, step_ns: f64) {
        let seconds = step_ns / NS_PER_S as f64;
        self.since_ns += step_ns;
        let [offset, mixed, drift] = self.variance;
        self.offset_ns += self.drift * step_ns;
        self.variance = [
            offset
                + step_ns * (2.0 * mixed + step_ns * drift)
                + OFFSET_WANDER_NS * OFFSET_WANDER_NS * seconds,
            mixed + step_ns * drift,
            drift + DRIFT_WANDER * DRIFT_WANDER * seconds,
        ];
    }

    /// Updates the filter with the delay of the fastest arrival of a block. A much longer delay means only a
    /// busy host, unless it persists; a much shorter one is always true.
    pub fn update(&mut self, late_ns: f64, sigma_ns: f64) {
        let expected_ns = (self.variance[0] + sigma_ns * sigma_ns).sqrt();
        if late_ns.abs() > GATE * expected_ns {
            self.refused += 1;
            let persists = self.refused >= REJECTED_IN_A_ROW && self.since_ns >= REJECTED_NS;
            if late_ns > 0.0 && !persists {
                self.doubt_ns = late_ns;
                return;
            }
            // Either the delay has changed, or the drift is larger than assumed.
            let drift = late_ns / self.since_ns.max(BLOCK_NS);
            self.variance[0] += late_ns * late_ns;
            self.variance[2] += drift * drift;
        }
        (self.refused, self.doubt_ns, self.since_ns) = (0, 0.0, 0.0);
        let [offset, mixed, drift] = self.variance;
        let gain = [offset, mixed].map(|v| v / (offset + sigma_ns * sigma_ns));
        self.offset_ns += gain[0] * late_ns;
        self.drift += gain[1] * late_ns;
        self.variance = [offset * (1.0 - gain[0]), mixed * (1.0 - gain[0]), drift - gain[1] * mixed];
    }
}

/// A series of arrivals, of which the fastest is used.
#[derive(Clone, Debug, Default)]
pub(super) struct Block {
    arrivals: u32,
    duration_ns: f64,
    fastest_ns: f64,
    sum_ns: f64,
}

impl Block {
    pub fn add(&mut self, residual_ns: f64, step_ns: f64) {
        self.fastest_ns = if self.arrivals == 0 { residual_ns } else { self.fastest_ns.min(residual_ns) };
        self.arrivals += 1;
        self.sum_ns += residual_ns;
        self.duration_ns += step_ns;
    }

    /// Delay of the fastest arrival and its standard uncertainty, nanoseconds, once the block is complete.
    /// The fastest of n arrivals is delayed by about 1/n of their mean delay, whether the delay is
    /// distributed exponentially or uniformly.
    /// `burst_ns`: the block lasts at least this time, so that it contains the end of a burst.
    pub fn close(&mut self, age_ns: f64, burst_ns: f64) -> Option<(f64, f64)> {
        let shortest_ns = BLOCK_NS.min(age_ns * BLOCK_PART).max(burst_ns);
        if self.arrivals < BLOCK_ARRIVALS || self.duration_ns < shortest_ns {
            return None;
        }
        let n = f64::from(self.arrivals);
        let spread_ns = (self.sum_ns / n - self.fastest_ns) / n;
        let closed = (self.fastest_ns, spread_ns.max(ARRIVAL_SIGMA_NS));
        *self = Self::default();
        Some(closed)
    }
}
