//! Observations of the sensor and their means.

use trifacet_wire::Status;

/// The output of the sensor at one time, or the mean over several.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Time, nanoseconds: UTC since 1970; with the twin since its start.
    pub time_ns: i64,
    /// tx, ty, tz (m), roll, pitch, yaw (rad).
    pub pose: [f64; 6],
    /// Standard uncertainty of each component, as published with the pose.
    pub sigmas: [f32; 6],
    /// Number of samples averaged.
    pub averaged: u32,
    /// Fingerprint of geometry, calibration and frames. Poses with different fingerprints are not
    /// comparable.
    pub config: u32,
    /// Status bits.
    pub status: Status,
}

/// Largest number of readings in a record at rest. Longer records are averaged.
const MOST_AT_REST: u64 = 10_000;

/// Number of poses per reading in a record at rest with this number of poses.
pub fn at_rest(poses: u64) -> u32 {
    poses.div_ceil(MOST_AT_REST).max(1) as u32
}

/// A running mean of observations.
#[derive(Clone, Copy, Debug, Default)]
pub struct Mean {
    n: f64,
    first_ns: i64,
    since_ns: f64,
    pose: [f64; 6],
    variance: [f64; 6],
    averaged: u32,
    status: Status,
}

impl Mean {
    /// Adds an observation. Returns the mean when `of` observations are complete, and then starts again.
    pub fn push(&mut self, look: &Observation, of: u32) -> Option<Observation> {
        if self.n == 0.0 {
            self.first_ns = look.time_ns;
        }
        self.n += 1.0;
        self.since_ns += (look.time_ns - self.first_ns) as f64;
        for i in 0..6 {
            self.pose[i] += look.pose[i];
            self.variance[i] += f64::from(look.sigmas[i]).powi(2);
        }
        self.averaged += look.averaged;
        self.status |= look.status;
        if self.n < f64::from(of) {
            return None;
        }
        let Mean { n, .. } = *self;
        let mean = Observation {
            time_ns: self.first_ns + (self.since_ns / n) as i64,
            pose: self.pose.map(|sum| sum / n),
            // The noise of the observations is independent.
            sigmas: self.variance.map(|sum| (sum.sqrt() / n) as f32),
            averaged: self.averaged,
            config: look.config,
            status: self.status,
        };
        *self = Self::default();
        Some(mean)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(crate) fn look(time_ns: i64, x: f64) -> Observation {
        Observation {
            time_ns,
            pose: [x; 6],
            sigmas: [2e-6; 6],
            averaged: 3,
            config: 9,
            status: Status::POSE_VALID,
        }
    }

    #[test]
    fn the_noise_of_a_mean_falls_with_the_root_of_its_observations() {
        let mut mean = Mean::default();
        for _ in 0..2 {
            assert_eq!((0..3).find_map(|k| mean.push(&look(10 * k, k as f64), 4)), None);
            let made = mean.push(&look(30, 3.0), 4).unwrap();
            assert_eq!((made.time_ns, made.pose, made.averaged), (15, [1.5; 6], 12));
            assert!((made.sigmas[0] - 1e-6).abs() < 1e-12);
        }
    }
}
