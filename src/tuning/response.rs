//! From repeated steps of one axis to the response of the beam: how far, how late, how fast.
//!
//! The response to a step of unit length, made on the sample at time zero, is taken as
//! `g (1 - exp(-(t - delay) / lag))` from the delay on: a gain in each of two directions across the
//! beam, a dead time and a first-order lag. A straight line in each window, which is the drift of the
//! mirror, is taken out of data and model alike. The steps go forth and back in turn, so that what
//! curves slowly cancels in the mean.

use nalgebra::{Matrix4, Vector4};

use crate::steering::Xy;

/// A lag is there if the fit without one is worse by so many deviations.
const LAG_SIGMAS: f64 = 3.0;
/// Windows whose delay is off by so many deviations of all are left out: the machine slept.
const OUTLIER: f64 = 5.0;

/// So many lags are tried before the best one is looked for in between.
const LAGS: u32 = 50;
/// A step with less than this part of the usual movement was not followed.
const FOLLOWED: f64 = 0.5;
/// Width of a numerical derivative, in periods.
const NARROW: f64 = 1e-3;

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

/// A fit to the mean of windows.
struct Fit {
    line: Line,
    times: Vec<f64>,
    period: f64,
    step: f64,
    /// Without their drift, metres.
    windows: Vec<Vec<Xy>>,
    mean: Vec<Xy>,
    /// Variance of a single value, metres^2.
    noise: f64,
    movement: Xy,
    delay: f64,
    lag: f64,
}

impl Fit {
    /// A fit to some of the windows, of whose values at each time `center` is taken.
    fn new(from: &Windows, which: &[usize], center: impl Fn(Vec<f64>) -> f64) -> Option<Self> {
        let (n, count) = (from.times.len(), which.len());
        if n < 8 || count < 4 {
            return None;
        }
        let line = Line::new(&from.times);
        let windows: Vec<_> = which.iter().map(|i| line.taken_out(&from.offsets[*i])).collect();
        let at = |i: usize, k: usize| center(windows.iter().map(|window| window[i][k]).collect());
        let mean: Vec<Xy> = (0..n).map(|i| [at(i, 0), at(i, 1)]).collect();
        // A few windows that are quite different say nothing of the noise.
        let scatter = middle(windows.iter().map(|w| distance(w, &mean)).collect());
        let noise = scatter / (2 * (n - 2)) as f64;
        let mut fit = Self {
            line,
            times: from.times.clone(),
            period: from.period,
            step: from.step,
            windows,
            mean,
            noise,
            movement: [0.0; 2],
            delay: 0.0,
            lag: 0.0,
        };
        fit.search();
        let (_, movement) = fit.cost(fit.delay, fit.lag);
        fit.movement = movement;
        (movement[0].hypot(movement[1]) > 0.0).then_some(fit)
    }

    /// The model at the times of the samples, without its drift, for unit movement.
    fn model(&self, delay: f64, lag: f64) -> Vec<f64> {
        let raw: Vec<_> = self.times.iter().map(|t| shape(*t, delay, lag)).collect();
        self.line.taken_out_of(&raw)
    }

    /// What is left of the mean, and the movement that leaves the least.
    fn cost(&self, delay: f64, lag: f64) -> (f64, Xy) {
        let model = self.model(delay, lag);
        let size: f64 = model.iter().map(|m| m * m).sum();
        let (mut dot, mut all) = ([0.0; 2], 0.0);
        for (m, y) in model.iter().zip(&self.mean) {
            dot = [dot[0] + m * y[0], dot[1] + m * y[1]];
            all += y[0] * y[0] + y[1] * y[1];
        }
        if size < 1e-9 {
            return (all, [0.0; 2]);
        }
        (all - (dot[0] * dot[0] + dot[1] * dot[1]) / size, dot.map(|d| d / size))
    }

    /// Looks for the delay and the lag that leave the least. The valley between them is narrow and bent:
    /// so the best delay is found for each of many lags, then the lag between the best two.
    fn search(&mut self) {
        let last = self.times[self.times.len() - 1];
        let (shortest, longest) = (self.period / 20.0, (last / 3.0).max(self.period));
        let ratio = (longest / shortest).ln() / f64::from(LAGS);
        let lag = |k: f64| shortest * (k * ratio).exp();
        let cost = |k: f64| self.best_delay(lag(k)).0;
        let best = least((0..=LAGS).map(|k| (cost(f64::from(k)), f64::from(k))));
        let (_, k) = golden([(best - 1.0).max(0.0), (best + 1.0).min(f64::from(LAGS))], cost);
        let (cost, delay) = self.best_delay(lag(k));
        (self.delay, self.lag) = (delay, lag(k));
        // Without a lag the beam has moved by a sample, and not by the one before it: the delay may be
        // anything in between. The longest one is the careful one.
        let from_zero = self.times.iter().copied().filter(|t| *t > 0.0 && *t <= last / 2.0);
        let jump = from_zero.map(|t| (self.cost(t, 0.0).0, t)).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((without, delay)) = jump
            && without - cost <= LAG_SIGMAS.powi(2) * self.noise / self.windows.len() as f64
        {
            (self.delay, self.lag) = (delay, 0.0);
        }
    }

    /// What the best delay for a lag leaves, and that delay.
    fn best_delay(&self, lag: f64) -> (f64, f64) {
        let most = self.times[self.times.len() - 1] / 2.0;
        let stride = (most / 100.0).max(self.period / 4.0);
        let cost = |delay: f64| self.cost(delay, lag).0;
        let coarse = (0..=(most / stride) as u32).map(|i| f64::from(i) * stride);
        let best = least(coarse.map(|delay| (cost(delay), delay)));
        golden([(best - stride).max(0.0), best + stride], cost)
    }

    /// What is left of a window, or of the mean.
    fn residual(&self, window: &[Xy]) -> Vec<Xy> {
        let model = self.model(self.delay, self.lag);
        let left = |(m, y): (&f64, &Xy)| [0, 1].map(|k| y[k] - self.movement[k] * m);
        model.iter().zip(window).map(left).collect()
    }

    /// The derivative of the model by the delay (`[1, 0]`) or the lag.
    fn slope(&self, [delay, lag]: [f64; 2]) -> Vec<f64> {
        let width = NARROW * self.period;
        let at = |by: f64| self.model(self.delay + delay * by, (self.lag + lag * by).max(0.0));
        let (after, before) = (at(width / 2.0), at(-width / 2.0));
        after.iter().zip(before).map(|(a, b)| (a - b) / width).collect()
    }

    /// How much later each window is than the fit, seconds: by the area between them while the beam moves.
    fn delays(&self) -> Vec<f64> {
        let [x, y] = self.movement;
        let scale = self.period_over_area() / (x * x + y * y);
        let of = |window: &Vec<Xy>| {
            let left = self.residual(window);
            self.moving().map(|j| -(left[j][0] * x + left[j][1] * y)).sum::<f64>() * scale
        };
        self.windows.iter().map(of).collect()
    }

    /// A delay by a period, over the area that it makes.
    fn period_over_area(&self) -> f64 {
        let half = self.period / 2.0;
        let (sooner, later) =
            (self.model(self.delay - half, self.lag), self.model(self.delay + half, self.lag));
        self.period / self.moving().map(|j| sooner[j] - later[j]).sum::<f64>()
    }

    /// The samples at which the beam moves.
    fn moving(&self) -> impl Iterator<Item = usize> {
        let end = self.delay + 6.0 * self.lag + 4.0 * self.period;
        (0..self.times.len()).filter(move |j| self.times[*j] > 0.0 && self.times[*j] <= end)
    }

    /// The covariance of movement (x, y), delay and lag, from how the windows scatter: whatever makes
    /// them scatter is in it.
    fn covariance(&self) -> Option<Matrix4<f64>> {
        let model = self.model(self.delay, self.lag);
        let (by_delay, by_lag) = match self.lag {
            // No derivative: the deviation of the delay is another one, and of the lag there is none.
            0.0 => (vec![0.0; model.len()], vec![0.0; model.len()]),
            _ => (self.slope([1.0, 0.0]), self.slope([0.0, 1.0])),
        };
        let row = |j: usize, axis: usize| {
            let along = self.movement[axis];
            let own = [if axis == 0 { model[j] } else { 0.0 }, if axis == 1 { model[j] } else { 0.0 }];
            Vector4::new(own[0], own[1], along * by_delay[j], along * by_lag[j])
        };
        let mut information = Matrix4::zeros();
        for j in 0..model.len() {
            information += row(j, 0) * row(j, 0).transpose() + row(j, 1) * row(j, 1).transpose();
        }
        if self.lag == 0.0 {
            information[(2, 2)] = 1.0;
            information[(3, 3)] = 1.0;
        }
        let mut scatter = Matrix4::zeros();
        for window in &self.windows {
            let left = self.residual(window);
            let pull = (0..left.len())
                .fold(Vector4::zeros(), |sum, j| sum + row(j, 0) * left[j][0] + row(j, 1) * left[j][1]);
            scatter += pull * pull.transpose();
        }
        let inverse = information.try_inverse()?;
        let count = self.windows.len() as f64;
        Some(inverse * scatter * inverse / (count * (count - 1.0)))
    }

    fn response(self) -> Response {
        let count = self.windows.len();
        let covariance = self.covariance().unwrap_or_else(|| Matrix4::from_element(f64::INFINITY));
        let sigma = |i: usize| covariance[(i, i)].max(0.0).sqrt();
        let resolved = self.lag > 0.0;
        let by_sampling = self.period / 12.0_f64.sqrt();
        let (_, spread) = middle_and_spread(&self.delays());
        let size = self.movement[0].hypot(self.movement[1]);
        let by_noise = self.noise * self.moving().count() as f64 * (self.period_over_area() / size).powi(2);
        let left = self.residual(&self.mean);
        let worst = left.iter().map(|r| r[0].hypot(r[1])).fold(0.0, f64::max);
        // Of many values the largest is some deviations off by chance.
        let by_chance = 4.0 * (2.0 * self.noise / count as f64).sqrt();
        // For people the mean is shown from zero up, not about the middle of its drift.
        let start = self.line.of(&self.times, |t| shape(t, self.delay, self.lag));
        let shown =
            |(j, t): (usize, &f64)| (*t, [0, 1].map(|k| self.mean[j][k] + self.movement[k] * start[j]));
        Response {
            gain: self.movement.map(|m| m / self.step),
            gain_sigma: [sigma(0) / self.step, sigma(1) / self.step],
            delay: self.delay,
            delay_sigma: if resolved { sigma(2) } else { by_sampling },
            lag: self.lag,
            lag_sigma: if resolved { sigma(3) } else { by_sampling },
            jitter: (spread * spread - by_noise).max(0.0).sqrt(),
            misfit: (worst - by_chance).max(0.0) / size,
            used: count,
            outliers: 0,
            unfollowed: 0,
            movement: self.movement,
            mean: self.times.iter().enumerate().map(shown).collect(),
        }
    }
}

/// The straight lines over the times of a window.
struct Line {
    constant: Vec<f64>,
    slope: Vec<f64>,
}

impl Line {
    fn new(times: &[f64]) -> Self {
        let n = times.len() as f64;
        let middle = times.iter().sum::<f64>() / n;
        let length = times.iter().map(|t| (t - middle).powi(2)).sum::<f64>().sqrt();
        let slope = times.iter().map(|t| (t - middle) / length).collect();
        Self { constant: vec![1.0 / n.sqrt(); times.len()], slope }
    }

    /// The line nearest to a course of values.
    fn nearest(&self, y: &[f64]) -> Vec<f64> {
        let dot = |q: &[f64]| q.iter().zip(y).map(|(q, y)| q * y).sum::<f64>();
        let (a, b) = (dot(&self.constant), dot(&self.slope));
        self.constant.iter().zip(&self.slope).map(|(c, s)| a * c + b * s).collect()
    }

    fn of(&self, times: &[f64], f: impl Fn(f64) -> f64) -> Vec<f64> {
        self.nearest(&times.iter().map(|t| f(*t)).collect::<Vec<_>>())
    }

    fn taken_out_of(&self, y: &[f64]) -> Vec<f64> {
        y.iter().zip(self.nearest(y)).map(|(y, line)| y - line).collect()
    }

    fn taken_out(&self, window: &[Xy]) -> Vec<Xy> {
        let [x, y] = [0, 1].map(|k| self.taken_out_of(&window.iter().map(|v| v[k]).collect::<Vec<_>>()));
        x.into_iter().zip(y).map(|(x, y)| [x, y]).collect()
    }
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

fn distance(a: &[Xy], b: &[Xy]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sum()
}

/// What has the least cost.
fn least(of: impl Iterator<Item = (f64, f64)>) -> f64 {
    of.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, x)| x)
}

/// The least value of a function in a range with one valley, and where it is, to a millionth of the
/// range: the golden section.
fn golden([mut low, mut high]: [f64; 2], f: impl Fn(f64) -> f64) -> (f64, f64) {
    const PART: f64 = 0.618_033_988_749_895;
    let inner = |low: f64, high: f64| [high - PART * (high - low), low + PART * (high - low)];
    let mut x = inner(low, high);
    let mut y = x.map(&f);
    for _ in 0..29 {
        if y[0] < y[1] {
            high = x[1];
            x = [inner(low, high)[0], x[0]];
            y = [f(x[0]), y[0]];
        } else {
            low = x[0];
            x = [x[1], inner(low, high)[1]];
            y = [y[1], f(x[1])];
        }
    }
    if y[0] < y[1] { (y[0], x[0]) } else { (y[1], x[1]) }
}

fn mean(values: Vec<f64>) -> f64 {
    let count = values.len() as f64;
    values.into_iter().sum::<f64>() / count
}

/// The median.
fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Median, and one standard deviation by the median of the distances from it.
fn middle_and_spread(values: &[f64]) -> (f64, f64) {
    let usual = middle(values.to_vec());
    (usual, 1.4826 * middle(values.iter().map(|v| (v - usual).abs()).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64;

    const STEP: f64 = 20e-6;

    /// What a loop is, for a recording at 1 kHz of 60 steps.
    #[derive(Clone, Copy, Debug)]
    struct Truth {
        gain: Xy,
        delay: f64,
        lag: f64,
        noise: f64,
        /// Of the mirror, metres and hertz.
        drift: (f64, f64),
        /// Deviation of the delay, seconds.
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

    proptest! {
        #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]
        #[test]
        fn the_loop_is_found_within_the_stated_deviations(
            x in -2.0_f64..2.0, y in 0.3_f64..2.0, delay in 0.05_f64..8.0, lag in 0.4_f64..5.0, seed: u64,
        ) {
            let truth = Truth { gain: [x, y], delay: delay * 1e-3, lag: lag * 1e-3, seed, ..TRUTH };
            let found = fit(&recorded(&truth)).unwrap();
            near(found.gain[0], found.gain_sigma[0], x);
            near(found.gain[1], found.gain_sigma[1], y);
            near(found.delay, found.delay_sigma, truth.delay);
            near(found.lag, found.lag_sigma, truth.lag);
            prop_assert!(found.gain_sigma[0] < 2e-3 && found.delay_sigma < 0.1e-3 && found.lag_sigma < 0.2e-3, "{found:?}");
            prop_assert!(found.misfit < 0.02 && found.used >= 55, "{} {}", found.misfit, found.used);
        }
    }

    #[test]
    fn the_stated_deviations_hold_on_average() {
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
        // 100 squared deviations: their mean is 1 to 0.14.
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
    fn jitter_is_found_and_steps_that_came_much_later_are_left_out() {
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
    fn a_stage_that_rings_does_not_fit_and_one_that_is_stuck_has_no_gain() {
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
    fn steps_that_were_not_followed_are_counted() {
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
}
