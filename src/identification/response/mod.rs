//! From repeated steps of one axis to the response of the beam: how far, how late, how fast.
//!
//! The response to a step of unit length, made on the sample at time zero, is taken as
//! `g (1 - exp(-(t - delay) / lag))` from the delay on: a gain in each of two directions across the
//! beam, a dead time and a first-order lag. A straight line in each window, which is the drift of the
//! mirror, is taken out of data and model alike. The steps go forth and back in turn, so that what
//! curves slowly cancels in the mean.
//!
//! - `fit`: the nearest response to the mean of windows. `numeric`: what it computes with.

mod fit;
mod numeric;
#[cfg(test)]
mod tests;

use fit::Fit;
use numeric::{mean, middle, middle_and_spread};
use trifacet_core::steering::Xy;

/// Windows whose delay is off by so many deviations of all are left out: the machine slept.
const OUTLIER: f64 = 5.0;
/// A step with less than this part of the usual movement was not followed.
const FOLLOWED: f64 = 0.5;

/// Windows around steps of one axis, all alike.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Windows {
    /// When the samples of a window were taken, after the one on which the step was made; seconds.
    pub times: Vec<f64>,
    /// The offset of the beam at these times, metres, turned around where the step went back.
    pub offsets: Vec<Vec<Xy>>,
    /// Time between samples, seconds.
    pub period: f64,
    /// Length of the steps, metres.
    pub step: f64,
}

/// The response of the beam to one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// Movement of the beam, x and y, per movement of the axis; with its deviations.
    pub gain: Xy,
    /// One standard deviation of the gain.
    pub gain_sigma: Xy,
    /// From the sample on which a command is computed to the start of its effect, seconds.
    pub delay: f64,
    /// One standard deviation of the delay.
    pub delay_sigma: f64,
    /// First-order lag, seconds; zero if it is too short to be seen at this rate.
    pub lag: f64,
    /// One standard deviation of the lag.
    pub lag_sigma: f64,
    /// One standard deviation of the delay from step to step, noise taken off, seconds. What happens
    /// between two samples shows only in part if the lag is shorter than that.
    pub jitter: f64,
    /// The largest difference between mean and fit, in parts of the movement, noise taken off.
    pub misfit: f64,
    /// Steps that are in the mean.
    pub used: usize,
    /// Steps that were left out since their delay was another one.
    pub outliers: usize,
    /// Steps that the beam did not follow, or only in part.
    pub unfollowed: usize,
    /// Movement of the beam per step, metres.
    pub movement: Xy,
    /// The mean over all steps less the drift: time in seconds, beam movement per step in metres.
    pub mean: Vec<(f64, Xy)>,
}

impl Response {
    /// The part of the movement that is done at a time.
    pub fn shape(&self, t: f64) -> f64 {
        shape(t, self.delay, self.lag)
    }
}

/// Fits the response. `None` if the windows are too few or nothing moves in them that could be fitted.
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

/// How many steps the beam has not followed by the end of their windows, or only in part.
fn unfollowed(windows: &Windows, movement: Xy) -> usize {
    let usual = movement[0].powi(2) + movement[1].powi(2);
    let last = windows.times.last().copied().unwrap_or_default();
    let part = |window: &Vec<Xy>, which: &dyn Fn(f64) -> bool| {
        let (mut sum, mut count) = (0.0, 0.0_f64);
        for (_, v) in windows.times.iter().zip(window).filter(|(t, _)| which(**t)) {
            sum += v[0] * movement[0] + v[1] * movement[1];
            count += 1.0;
        }
        sum / count.max(1.0)
    };
    let moved = |w: &&Vec<Xy>| part(w, &|t| t > last / 2.0) - part(w, &|t| t <= 0.0) < FOLLOWED * usual;
    windows.offsets.iter().filter(moved).count()
}

/// The part of a movement that is done at `t`; a sample at the very moment of a jump has seen it.
fn shape(t: f64, delay: f64, lag: f64) -> f64 {
    let since = t - delay;
    if lag > 0.0 {
        if since > 0.0 { 1.0 - (-since / lag).exp() } else { 0.0 }
    } else {
        f64::from(u8::from(since > -1e-9))
    }
}
