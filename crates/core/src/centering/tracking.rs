//! The tracking filter: position and velocity of the apex, from noisy positions.
//!
//! An alpha-beta filter: it predicts with constant velocity, and corrects position and velocity by the
//! innovation, the difference between the next position and the prediction. Its poles are those of a
//! second-order system with damping 0.7 and the configured bandwidth as natural frequency. They are placed
//! anew for each time step.
//!
//! - The velocity of a sine of frequency f has the gain 1/sqrt(1 + (f/bandwidth)^4) and the delay 1.4/(2 pi
//!   bandwidth).
//! - White noise of the position passes with the factor sqrt(1.11 bandwidth * 2 / rate) on its standard
//!   deviation.
//! - A larger bandwidth follows faster motion, and passes more noise to the stage.
//!
//! A jump of the mirror is not a velocity. An innovation beyond `GATE` times its usual size is ignored
//! once. The second one in a row resets the position and keeps the velocity; the controller then corrects the
//! jump as an error. The usual size is a running rms of the innovations; an innovation beyond the gate enters
//! it with a bound.

use std::f64::consts::TAU;

use crate::steering::{BeamOffset, BeamPoint};
use crate::time::Mono;

/// An innovation beyond this many times its usual size is a jump.
const GATE: f64 = 6.0;
/// Number of innovations over which the usual size is averaged.
const WINDOW: f64 = 64.0;
/// Usual size of an innovation before the first one, metres.
const UNKNOWN: f64 = 3e-6;
/// Damping of the poles: maximally flat (Butterworth) response.
const DAMPING: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// The state of the filter.
#[derive(Clone, Debug, Default)]
pub struct Tracking {
    track: Option<Track>,
}

/// State of the track: metres, metres per second.
#[derive(Clone, Copy, Debug)]
struct Track {
    time: Mono,
    position: BeamPoint,
    velocity: BeamOffset,
    /// Of the innovations, square metres.
    variance: f64,
    /// The last innovation was beyond the gate.
    suspect: bool,
}

impl Tracking {
    /// Discards the track: the next position is unrelated to it.
    pub fn reset(&mut self) {
        self.track = None;
    }

    /// Velocity of the apex, metres per second; zero while it is unknown.
    pub fn velocity(&self) -> BeamOffset {
        self.track.map_or(BeamOffset::default(), |track| track.velocity)
    }

    /// Takes a position (must be finite, metres) with its time. The filter starts again after a pause longer
    /// than `patience_s` seconds.
    pub fn update(&mut self, position: BeamPoint, time: Mono, bandwidth_hz: f64, patience_s: f64) {
        let passed = self.track.map(|track| time.seconds_since(track.time));
        match (&mut self.track, passed) {
            (Some(track), Some(dt)) if dt > 0.0 && dt <= patience_s => {
                track.update(position, dt, bandwidth_hz);
                track.time = time;
            }
            (Some(_), Some(0.0)) => {}
            (track, _) => *track = Some(Track::at(position, time)),
        }
    }
}

impl Track {
    fn at(position: BeamPoint, time: Mono) -> Self {
        Self { time, position, velocity: BeamOffset::default(), variance: UNKNOWN * UNKNOWN, suspect: false }
    }

    fn update(&mut self, measured: BeamPoint, dt: f64, bandwidth_hz: f64) {
        let predicted = [0, 1].map(|i| self.position[i] + self.velocity[i] * dt);
        let innovation = [0, 1].map(|i| measured[i] - predicted[i]);
        let square = innovation[0].powi(2) + innovation[1].powi(2);
        let most = GATE * GATE * self.variance;
        // One innovation far beyond the gate increases the usual size by a factor of sqrt(3) at most.
        self.variance += (square.min(2.0 * WINDOW * self.variance) - self.variance) / WINDOW;
        if square > most {
            self.position = if self.suspect { measured } else { BeamPoint(predicted) };
            self.suspect = !self.suspect;
            return;
        }
        self.suspect = false;
        let [alpha, beta] = gains(bandwidth_hz * dt);
        self.position = BeamPoint([0, 1].map(|i| predicted[i] + alpha * innovation[i]));
        self.velocity = BeamOffset([0, 1].map(|i| self.velocity[i] + beta / dt * innovation[i]));
    }
}

/// Gains for position and velocity, for a bandwidth in cycles per sample. The poles of the filter are those
/// of the second-order system, sampled.
fn gains(bandwidth: f64) -> [f64; 2] {
    let decay = (-DAMPING * TAU * bandwidth).exp();
    let turn = (TAU * bandwidth * (1.0 - DAMPING * DAMPING).sqrt()).min(std::f64::consts::PI);
    [1.0 - decay * decay, 1.0 + decay * decay - 2.0 * decay * turn.cos()]
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    use super::*;

    const RATE: f64 = 10_000.0;
    const BAND: f64 = 200.0;

    /// Velocities for a motion of the apex along x, metres as a function of seconds.
    fn track(course: impl Fn(f64) -> f64, noise: f64, samples: u32) -> Vec<f64> {
        let mut random = rand_pcg::Pcg64::seed_from_u64(5);
        let mut tracking = Tracking::default();
        (0..samples)
            .map(|k| {
                let t = f64::from(k) / RATE;
                let x = course(t) + noise * random.sample::<f64, _>(StandardNormal);
                tracking.update(BeamPoint([x, 0.0]), Mono((t * 1e9).round() as i64), BAND, 0.01);
                tracking.velocity()[0]
            })
            .collect()
    }

    fn rms(x: &[f64]) -> f64 {
        (x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64).sqrt()
    }

    #[test]
    fn a_steady_velocity_is_found_without_error() {
        let velocity = track(|t| 1e-3 * t, 0.0, 1000);
        assert!((velocity[999] / 1e-3 - 1.0).abs() < 1e-6, "{}", velocity[999]);
    }

    #[test]
    fn a_sine_is_attenuated_according_to_the_bandwidth() {
        for (frequency, gain) in [(20.0, 1.0), (200.0, 0.5_f64.sqrt()), (800.0, 1.0 / 257_f64.sqrt())] {
            let omega = TAU * frequency;
            let velocity = track(|t| 10e-6 * (omega * t).sin(), 0.0, 20_000);
            let found = rms(&velocity[5000..15_000]) * 2_f64.sqrt() / (10e-6 * omega);
            assert!((found / gain - 1.0).abs() < 0.15, "{frequency} {found} {gain}");
        }
    }

    #[test]
    fn the_noise_gain_agrees_with_the_documentation() {
        // The noise of the velocity, expressed as a position: integrated as the controller does.
        let velocity = track(|_| 0.0, 1e-6, 200_000);
        let mut position = 0.0;
        let mut moved: Vec<f64> = Vec::new();
        for v in velocity {
            position += v / RATE;
            moved.push(position);
        }
        let expected = 1e-6 * (1.11 * BAND * 2.0 / RATE).sqrt();
        assert!((rms(&moved[1000..]) / expected - 1.0).abs() < 0.15, "{} {expected}", rms(&moved[1000..]));
    }

    #[test]
    fn a_jump_does_not_change_the_velocity() {
        let course = |t: f64| 1e-3 * t + if t > 0.05 { 100e-6 } else { 0.0 };
        let velocity = track(course, 0.1e-6, 1000);
        let worst = velocity[480..520].iter().map(|v| (v - 1e-3).abs()).fold(0.0, f64::max);
        assert!(worst < 0.3e-3, "{worst}");
        // Without the gate, 100 um at a bandwidth of 200 Hz would appear as 60 mm/s.
    }

    #[test]
    fn a_lasting_change_of_any_size_is_followed() {
        let velocity = track(|t| if t > 0.05 { 0.2 * (t - 0.05) } else { 0.0 }, 0.01e-6, 1500);
        assert!((velocity[1499] / 0.2 - 1.0).abs() < 0.01, "{}", velocity[1499]);
    }

    #[test]
    fn a_pause_restarts_the_tracker() {
        let mut tracking = Tracking::default();
        for k in 0..100 {
            tracking.update(BeamPoint([f64::from(k) * 1e-6, 0.0]), Mono(i64::from(k) * 100_000), BAND, 0.001);
        }
        assert!(tracking.velocity()[0] > 1e-3);
        tracking.update(BeamPoint([0.0; 2]), Mono(99 * 100_000), BAND, 0.001);
        assert!(tracking.velocity()[0] > 1e-3, "the same sample twice changes nothing");
        tracking.update(BeamPoint([1.0, 0.0]), Mono(200 * 100_000), BAND, 0.001);
        assert_eq!(tracking.velocity(), BeamOffset([0.0; 2]));
    }
}
