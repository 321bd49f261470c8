//! Least-squares fit of a response to the mean of windows, with its uncertainties.

use nalgebra::{Matrix4, Vector4};

use super::numeric::{Line, golden, least, middle, middle_and_spread};
use super::{Response, Windows, shape};

/// A lag is significant if the fit without one is worse by this many standard deviations.
const LAG_SIGMAS: f64 = 3.0;
/// Number of lags of the coarse search.
const LAGS: u32 = 50;
/// Step of a numerical derivative, in periods.
const NARROW: f64 = 1e-3;

/// A fit to the mean of windows.
pub(super) struct Fit {
    line: Line,
    times: Vec<f64>,
    period: f64,
    step: f64,
    /// The windows without their drift, metres.
    windows: Vec<Vec<[f64; 2]>>,
    mean: Vec<[f64; 2]>,
    /// Variance of a single value, metres squared.
    noise: f64,
    pub(super) movement: [f64; 2],
    delay: f64,
    lag: f64,
}

impl Fit {
    /// Fits some of the windows. `center` gives the average of their values at each time.
    pub(super) fn new(from: &Windows, which: &[usize], center: impl Fn(Vec<f64>) -> f64) -> Option<Self> {
        let (n, count) = (from.times.len(), which.len());
        if n < 8 || count < 4 {
            return None;
        }
        let line = Line::new(&from.times);
        let windows: Vec<_> = which.iter().map(|i| line.taken_out(&from.offsets[*i])).collect();
        let at = |i: usize, k: usize| center(windows.iter().map(|window| window[i][k]).collect());
        let mean: Vec<[f64; 2]> = (0..n).map(|i| [at(i, 0), at(i, 1)]).collect();
        // The median: a few deviating windows must not affect the estimate of the noise.
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

    /// The model at the times of the samples, without drift, for unit movement.
    fn model(&self, delay: f64, lag: f64) -> Vec<f64> {
        let raw: Vec<_> = self.times.iter().map(|t| shape(*t, delay, lag)).collect();
        self.line.taken_out_of(&raw)
    }

    /// Sum of squared residuals of the mean, and the movement that minimizes it.
    fn cost(&self, delay: f64, lag: f64) -> (f64, [f64; 2]) {
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

    /// Searches for the delay and the lag with the least cost. The valley of the cost is narrow and curved.
    /// Therefore the best delay is found for each of many lags, and then the lag between the best two.
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
        // Without a lag the movement lies between two samples, and the delay may be anything in between. The
        // longest delay is the cautious choice.
        let from_zero = self.times.iter().copied().filter(|t| *t > 0.0 && *t <= last / 2.0);
        let jump = from_zero.map(|t| (self.cost(t, 0.0).0, t)).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((without, delay)) = jump
            && without - cost <= LAG_SIGMAS.powi(2) * self.noise / self.windows.len() as f64
        {
            (self.delay, self.lag) = (delay, 0.0);
        }
    }

    /// Least cost for a lag, and the delay that gives it.
    fn best_delay(&self, lag: f64) -> (f64, f64) {
        let most = self.times[self.times.len() - 1] / 2.0;
        let stride = (most / 100.0).max(self.period / 4.0);
        let cost = |delay: f64| self.cost(delay, lag).0;
        let coarse = (0..=(most / stride) as u32).map(|i| f64::from(i) * stride);
        let best = least(coarse.map(|delay| (cost(delay), delay)));
        golden([(best - stride).max(0.0), best + stride], cost)
    }

    /// Residuals of a window, or of the mean.
    fn residual(&self, window: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let model = self.model(self.delay, self.lag);
        let left = |(m, y): (&f64, &[f64; 2])| [0, 1].map(|k| y[k] - self.movement[k] * m);
        model.iter().zip(window).map(left).collect()
    }

    /// Derivative of the model with respect to the delay (`[1, 0]`) or the lag (`[0, 1]`).
    fn slope(&self, [delay, lag]: [f64; 2]) -> Vec<f64> {
        let width = NARROW * self.period;
        let at = |by: f64| self.model(self.delay + delay * by, (self.lag + lag * by).max(0.0));
        let (after, before) = (at(width / 2.0), at(-width / 2.0));
        after.iter().zip(before).map(|(a, b)| (a - b) / width).collect()
    }

    /// Delay of each window relative to the fit, seconds, from the area between them during the movement.
    pub(super) fn delays(&self) -> Vec<f64> {
        let [x, y] = self.movement;
        let scale = self.period_over_area() / (x * x + y * y);
        let of = |window: &Vec<[f64; 2]>| {
            let left = self.residual(window);
            self.moving().map(|j| -(left[j][0] * x + left[j][1] * y)).sum::<f64>() * scale
        };
        self.windows.iter().map(of).collect()
    }

    /// Ratio of a delay of one period to the area that it causes.
    fn period_over_area(&self) -> f64 {
        let half = self.period / 2.0;
        let (sooner, later) =
            (self.model(self.delay - half, self.lag), self.model(self.delay + half, self.lag));
        self.period / self.moving().map(|j| sooner[j] - later[j]).sum::<f64>()
    }

    /// Indices of the samples during the movement.
    fn moving(&self) -> impl Iterator<Item = usize> {
        let end = self.delay + 6.0 * self.lag + 4.0 * self.period;
        (0..self.times.len()).filter(move |j| self.times[*j] > 0.0 && self.times[*j] <= end)
    }

    /// Covariance of movement (x, y), delay and lag by the sandwich estimator: derived from the scatter of
    /// the windows, whatever its cause.
    fn covariance(&self) -> Option<Matrix4<f64>> {
        let model = self.model(self.delay, self.lag);
        let (by_delay, by_lag) = match self.lag {
            // No derivative. The uncertainty of the delay follows from the sampling, and there is no lag.
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

    pub(super) fn response(self) -> Response {
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
        // Among many values, the largest differs by several standard deviations by chance.
        let by_chance = 4.0 * (2.0 * self.noise / count as f64).sqrt();
        // For the plot the mean begins at zero instead of being centred about its drift.
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

fn distance(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sum()
}
