//! Response of the beam to an axis, from repeated steps: gain, delay and lag.
//!
//! The model of the response to a step of unit length, commanded on the sample at time zero, is
//! `g (1 - exp(-(t - delay) / lag))` from the delay on: a gain in each of two directions perpendicular to the
//! beam, a dead time and a first-order lag. A straight line in each window represents the drift of the
//! mirror. It is removed from the data and from the model alike. The steps alternate in direction, so that
//! slow curvature cancels in the mean.
//!
//! - `fit`: least-squares fit to the mean of windows. `numeric`: its numerical methods.

mod fit;
mod numeric;
#[cfg(test)]
mod tests;

use fit::Fit;
use numeric::{mean, middle, middle_and_spread};

/// Windows whose delay differs by more than this many standard deviations are left out: the machine was late.
const OUTLIER: f64 = 5.0;
/// A step with less than this fraction of the usual movement was not followed.
const FOLLOWED: f64 = 0.5;

/// Windows around the steps of one axis, all of the same length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Windows {
    /// Times of the samples of a window relative to the sample on which the step was commanded, seconds.
    pub times: Vec<f64>,
    /// Offsets of the beam at these times, metres, with reversed sign for steps in negative direction.
    pub offsets: Vec<Vec<[f64; 2]>>,
    /// Sample period, seconds.
    pub period: f64,
    /// Length of the steps, metres.
    pub step: f64,
}

/// The response of the beam to one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// Movement of the beam, x and y, per movement of the axis.
    pub gain: [f64; 2],
    /// Standard uncertainty of the gain.
    pub gain_sigma: [f64; 2],
    /// Time from the sample on which a command is computed to the beginning of its effect, seconds.
    pub delay: f64,
    /// Standard uncertainty of the delay, seconds.
    pub delay_sigma: f64,
    /// First-order lag, seconds; zero if it is too short to be resolved at this sample rate.
    pub lag: f64,
    /// Standard uncertainty of the lag, seconds.
    pub lag_sigma: f64,
    /// Standard deviation of the delay from step to step, corrected for noise, seconds. Variation between two
    /// samples is resolved only in part if the lag is shorter than a sample period.
    pub jitter: f64,
    /// Largest difference between mean and fit, as a fraction of the movement, corrected for noise.
    pub misfit: f64,
    /// Steps in the mean.
    pub used: usize,
    /// Steps left out because of their delay.
    pub outliers: usize,
    /// Steps that the beam did not follow, or followed only in part.
    pub unfollowed: usize,
    /// Movement of the beam per step, metres.
    pub movement: [f64; 2],
    /// The mean over all steps without drift: time in seconds, movement of the beam per step in metres.
    pub mean: Vec<(f64, [f64; 2])>,
}

impl Response {
    /// Completed fraction of the movement at time `t`, seconds.
    pub fn shape(&self, t: f64) -> f64 {
        shape(t, self.delay, self.lag)
    }
}

/// Fits the response. `None` if there are too few windows, or no movement in them.
pub fn fit(windows: &Windows) -> Option<Response> {
    let all: Vec<usize> = (0..windows.offsets.len()).collect();
    let first = Fit::new(windows, &all, middle)?;
    let late = first.delays();
    let (usual, spread) = middle_and_spread(&late);
    let reach = (OUTLIER * spread).max(windows.period / 2.0);
    let kept: Vec<usize> = all.into_iter().filter(|i| (late[*i] - usual).abs() <= reach).collect();
    let fit = Fit::new(windows, &kept, mean)?;
    let unfollowed = unfollowed(windows, fit.movement);
    let outliers = late.len() - kept.len();
    Some(Response { outliers, unfollowed, ..fit.response() })
}

/// Number of steps that the beam has not followed by the end of the window, or only in part.
fn unfollowed(windows: &Windows, movement: [f64; 2]) -> usize {
    let usual = movement[0].powi(2) + movement[1].powi(2);
    let last = windows.times.last().copied().unwrap_or_default();
    let part = |window: &Vec<[f64; 2]>, which: &dyn Fn(f64) -> bool| {
        let (mut sum, mut count) = (0.0, 0.0_f64);
        for (_, v) in windows.times.iter().zip(window).filter(|(t, _)| which(**t)) {
            sum += v[0] * movement[0] + v[1] * movement[1];
            count += 1.0;
        }
        sum / count.max(1.0)
    };
    let moved = |w: &&Vec<[f64; 2]>| part(w, &|t| t > last / 2.0) - part(w, &|t| t <= 0.0) < FOLLOWED * usual;
    windows.offsets.iter().filter(moved).count()
}

/// Completed fraction of a movement at `t`. A sample exactly at the time of a jump has the whole movement.
fn shape(t: f64, delay: f64, lag: f64) -> f64 {
    let since = t - delay;
    if lag > 0.0 {
        if since > 0.0 { 1.0 - (-since / lag).exp() } else { 0.0 }
    } else {
        f64::from(u8::from(since > -1e-9))
    }
}
