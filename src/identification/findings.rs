//! Derives the keys of the configuration from a recording, with their uncertainties and plausibility.

use trifacet_core::steering::{BeamOffset, BeamPoint, StagePosition};

use super::observation::{self, Observation};
use super::plan::{Plan, USED, refused, um};
use super::record::{AXES, Recording, Step};
use super::response::{self, Response, Windows};
use crate::exit::Failure;

/// A gain counts as movement from this value, and from this multiple of its standard uncertainty.
const MOVES: f64 = 0.01;
const MOVES_SIGMAS: f64 = 5.0;
/// Largest relative standard uncertainty of a gain.
const GAIN_SIGMA: f64 = 0.03;
/// Largest difference between response and fit, as a fraction of the movement.
const MISFIT: f64 = 0.1;
/// The movement must end within a dwell time: this many lags after the delay.
const SETTLED: f64 = 4.0;
/// Columns with a smaller sine of the angle between them count as parallel; the configuration refuses them.
const PARALLEL: f64 = 0.1;
/// Least fraction of a commanded movement in the readback of a stage that follows.
const FOLLOWED: f64 = 0.5;
/// Errors of the readback above which there is a remark: relative error of its scale, and offset in metres.
const SCALE: f64 = 0.03;
const OFFSET: f64 = 1e-6;

/// A number with its standard uncertainty.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// The number.
    pub value: f64,
    /// Its standard uncertainty.
    pub sigma: f64,
}

/// The readback of an axis relative to the commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Readback {
    /// Movement of the readback per commanded movement.
    pub scale: Measured,
    /// Readback minus command, metres.
    pub offset: f64,
    /// Standard deviation of the white noise at rest, metres.
    pub noise: f64,
}

/// Results of the measurement.
#[derive(Clone, Debug)]
pub struct Findings {
    /// The steering matrix: rows for x and y of the beam, one column per axis.
    pub matrix: [[Measured; 2]; 2],
    /// Position at which the beam crosses the plane of the apex with the stage at zero, metres.
    pub origin: [Measured; 2],
    /// Time from a sample to the beginning of the effect of its command, seconds.
    pub delay: Measured,
    /// First-order lag, seconds.
    pub lag: Measured,
    /// Standard deviation of the delay from step to step, seconds.
    pub jitter: f64,
    /// Time from a sample to its command, which is part of the delay: median and maximum, seconds.
    pub computed: [f64; 2],
    /// Standard deviation of the white noise of the offset at rest, metres.
    pub noise: BeamOffset,
    /// Mean total power at rest, watts.
    pub power: f64,
    /// Readback per axis, if the stage has one.
    pub readback: Option<[Readback; 2]>,
    /// Response to each axis.
    pub responses: [Response; 2],
    /// Reasons for which the result cannot be trusted; empty if it can.
    pub doubts: Vec<String>,
    /// Further information for the operator.
    pub remarks: Vec<String>,
}

impl Findings {
    /// Evaluates a recording. `period` is the sample period in seconds.
    ///
    /// # Errors
    /// [`exit::DATA`](crate::exit::DATA) if too few steps can be used, or nothing moved.
    pub fn new(recording: &Recording, period: f64) -> Result<Self, Failure> {
        let fit = |axis: usize| {
            let windows = windows(recording, axis, period);
            response::fit(&windows).ok_or_else(|| {
                refused(format!(
                    "only {} of {} steps of the {} axis were made in time and without a lost sample, or nothing moved; \
                     at least {:.0} are needed",
                    windows.offsets.len(),
                    recording.plan.steps,
                    AXES[axis],
                    USED * f64::from(recording.plan.steps)
                ))
            })
        };
        let responses = [fit(0)?, fit(1)?];
        let cell = |row: usize, axis: usize| {
            let response = &responses[axis];
            Measured { value: response.gain[row], sigma: response.gain_sigma[row] }
        };
        let matrix = [[cell(0, 0), cell(0, 1)], [cell(1, 0), cell(1, 1)]];
        let computed = || recording.steps.iter().map(|step| step.computed);
        let mut findings = Self {
            matrix,
            origin: origin(recording, &matrix),
            delay: Measured::default(),
            lag: Measured::default(),
            jitter: responses[0].jitter.max(responses[1].jitter),
            computed: [median(computed()), computed().fold(0.0, f64::max)],
            noise: recording.plan.noise,
            power: rest_power(recording),
            readback: readback(recording),
            responses,
            doubts: Vec::new(),
            remarks: Vec::new(),
        };
        findings.join(period);
        findings.judge(&recording.plan, period);
        findings.remark();
        if recording.repeats > 0 {
            findings
                .remarks
                .push(format!("samples stopped now and then: {} steps were repeated", recording.repeats));
        }
        Ok(findings)
    }

    /// One delay and one lag for the loop from those of both axes: the weighted means if they agree,
    /// otherwise the longer delay and the shorter lag, which give the more cautious gains.
    fn join(&mut self, period: f64) {
        let [x, y] = &self.responses;
        let delays = [(x.delay, x.delay_sigma), (y.delay, y.delay_sigma)];
        let lags = [(x.lag, x.lag_sigma), (y.lag, y.lag_sigma)];
        let agree = |[a, b]: [(f64, f64); 2]| (a.0 - b.0).abs() <= 3.0 * a.1.hypot(b.1) + 0.05 * period;
        if agree(delays) && agree(lags) && (x.lag > 0.0) == (y.lag > 0.0) {
            (self.delay, self.lag) = (mean(delays), mean(lags));
            return;
        }
        let pick = |pair: [(f64, f64); 2], second: bool| {
            let (value, sigma) = pair[usize::from(second)];
            Measured { value, sigma }
        };
        self.delay = pick(delays, delays[1].0 > delays[0].0);
        self.lag = pick(lags, lags[1].0 < lags[0].0);
        self.remarks.push(format!(
            "the axes differ: x has a delay of {:.3} ms and a lag of {:.3} ms, y {:.3} ms and {:.3} ms; \
             the longer delay and the shorter lag are used",
            x.delay * 1e3,
            x.lag * 1e3,
            y.delay * 1e3,
            y.lag * 1e3
        ));
    }

    fn judge(&mut self, plan: &Plan, period: f64) {
        let mut doubts = Vec::new();
        for (axis, response) in self.responses.iter().enumerate() {
            let read = self.readback.map(|readback| readback[axis].scale.value);
            doubts.extend(doubts_of(AXES[axis], response, read, plan, period));
        }
        let [[a, b], [c, d]] = self.matrix.map(|row| row.map(|cell| cell.value));
        let sine = (a * d - b * c) / (a.hypot(c) * b.hypot(d));
        if doubts.is_empty() && sine.abs() < PARALLEL {
            doubts.push(format!(
                "both axes move the beam in nearly the same direction: the sine of the angle between the directions \
                 is {:.3}, at least {PARALLEL} is needed", sine.abs()
            ));
        }
        self.doubts = doubts;
    }

    fn remark(&mut self) {
        if self.lag.value == 0.0 {
            self.remarks.push(
                "the lag is too short to be resolved at this sample rate; the delay ends at the first sample that shows the whole effect".into(),
            );
        }
        for (axis, readback) in self.readback.iter().flatten().enumerate() {
            let Readback { scale, offset, .. } = *readback;
            // The scale of a stage that does not follow has no meaning.
            if scale.value >= FOLLOWED && (scale.value - 1.0).abs() > SCALE + 3.0 * scale.sigma {
                self.remarks.push(format!(
                    "the readback of the {} axis moves by {:.3} of the commanded movement: multiply \
                     channels.readback_um_per_v by {:.4}, unless steering.full_scale_um is wrong",
                    AXES[axis],
                    scale.value,
                    1.0 / scale.value
                ));
            }
            if offset.abs() > OFFSET {
                self.remarks.push(format!(
                    "the readback of the {} axis is {} um off the command",
                    AXES[axis],
                    um(offset)
                ));
            }
        }
    }
}

/// Mean total power before the first movement, watts.
fn rest_power(recording: &Recording) -> f64 {
    let rest = &recording.looks[..recording.rest];
    rest.iter().map(|look| look.power).sum::<f64>() / rest.len().max(1) as f64
}

/// Reasons to distrust the response to an axis. `read`: movement of its readback per commanded movement.
fn doubts_of(name: &str, response: &Response, read: Option<f64>, plan: &Plan, period: f64) -> Vec<String> {
    let Response { gain, gain_sigma, delay, lag, .. } = *response;
    let (size, sigma) = (gain[0].hypot(gain[1]), gain_sigma[0].hypot(gain_sigma[1]));
    let fits = size >= MOVES && size >= MOVES_SIGMAS * sigma;
    if !fits {
        let moved = format!(
            "the beam moves by {} +- {} um for a step of {} um",
            um(size * plan.step),
            um(sigma * plan.step),
            um(plan.step)
        );
        return vec![match read {
            Some(read) if read.abs() < FOLLOWED => {
                format!(
                    "the stage does not follow on the {name} axis: its readback moves by {} um and {moved}",
                    um(read * plan.step)
                )
            }
            Some(_) => format!(
                "the {name} axis does not move the beam: the readback of the stage follows, but {moved}"
            ),
            None => format!("the stage does not follow on the {name} axis: {moved}"),
        }];
    }
    let mut doubts = Vec::new();
    if let Some(read) = read.filter(|read| *read < 0.0) {
        doubts.push(format!(
            "the readback of the {name} axis moves against the commands, by {} um for a step of {} um: \
             the beam responds later than a dwell time, or the polarity of the readback is wrong",
            um(read * plan.step),
            um(plan.step)
        ));
    }
    if response.unfollowed > 0 {
        doubts.push(format!(
            "the stage did not follow {} of {} steps of the {name} axis",
            response.unfollowed, plan.steps
        ));
    }
    if (response.used as f64) < USED * f64::from(plan.steps) {
        doubts.push(format!(
            "of {} steps of the {name} axis only {} can be used; the others were late ({} by the response of the beam) or had lost samples: is the machine busy?",
            plan.steps, response.used, response.outliers
        ));
    }
    if sigma > GAIN_SIGMA * size {
        doubts.push(format!("the gain of the {name} axis, {size:.3}, has a standard uncertainty of {sigma:.3}: use more --steps, or a larger --step"));
    }
    let dwell = plan.dwell as f64 * period;
    if delay + SETTLED * lag > dwell {
        doubts.push(format!(
            "the {name} axis has not settled {:.0} ms after a step (delay {:.1} ms, lag {:.1} ms): use a longer --dwell",
            dwell * 1e3, delay * 1e3, lag * 1e3
        ));
    }
    if response.misfit > MISFIT {
        doubts.push(format!(
            "the response of the {name} axis is not a delay with a first-order lag: it differs by up to {:.0} %, allowed: {:.0} %",
            response.misfit * 1e2, MISFIT * 1e2
        ));
    }
    if response.jitter > 0.5 * (delay + lag) {
        doubts.push(format!(
            "the delay of the {name} axis varies by {:.3} ms from step to step; the fitted delay is {:.3} ms",
            response.jitter * 1e3,
            delay * 1e3
        ));
    }
    if response.delay_sigma > (0.2 * delay).max(period / 2.0) {
        let known = if response.delay_sigma < dwell {
            format!(
                ", {:.3} ms, has a standard uncertainty of {:.3} ms",
                delay * 1e3,
                response.delay_sigma * 1e3
            )
        } else {
            " cannot be distinguished from the noise".into()
        };
        doubts.push(format!("the delay of the {name} axis{known}: use more --steps, or a larger --step"));
    }
    doubts
}

/// Windows around the steps of an axis. Steps with a lost sample or a late command are left out.
fn windows(recording: &Recording, axis: usize, period: f64) -> Windows {
    let dwell = recording.plan.dwell;
    let usual = median(recording.steps.iter().map(|step| step.computed)) + period / 2.0;
    let mut windows = Windows { period, step: recording.plan.step, ..Windows::default() };
    for step in recording.steps.iter().filter(|step| step.axis == axis && step.computed <= usual) {
        let range = (step.on + 1).saturating_sub(dwell / 2)..=step.on + dwell;
        let Some(looks) = recording.looks.get(range) else { continue };
        if !observation::whole(looks) {
            continue;
        }
        let sign = if step.forth { 1.0 } else { -1.0 };
        let zero = recording.looks[step.on].time;
        windows.times.resize(looks.len(), 0.0);
        for (time, look) in windows.times.iter_mut().zip(looks) {
            *time += look.time.seconds_since(zero);
        }
        windows.offsets.push(looks.iter().map(|look| look.offset.map(|d| sign * d)).collect());
    }
    let count = windows.offsets.len() as f64;
    windows.times.iter_mut().for_each(|time| *time /= count);
    windows
}

/// Observations after a step, once the stage has settled.
fn settled<'a>(recording: &'a Recording, step: &Step) -> &'a [Observation] {
    let dwell = recording.plan.dwell;
    recording.looks.get(step.on + 1 + dwell / 2..=step.on + dwell).unwrap_or_default()
}

/// Position of the beam minus the contribution of the stage, by its readback or else by the command.
fn origin(recording: &Recording, matrix: &[[Measured; 2]; 2]) -> [Measured; 2] {
    let (mut at_zero, mut stands) = (Vec::new(), [0.0_f64; 2]);
    for step in &recording.steps {
        for look in settled(recording, step) {
            let q = look.readback.unwrap_or(step.to);
            let moved = matrix.map(|[a, b]| a.value * q[0] + b.value * q[1]);
            at_zero.push(BeamPoint([look.beam[0] - moved[0], look.beam[1] - moved[1]]));
            stands = [stands[0].max(q[0].abs()), stands[1].max(q[1].abs())];
        }
    }
    let Some(mean) = observation::mean(at_zero.iter().copied()) else { return [Measured::default(); 2] };
    let count = at_zero.len() as f64;
    [0, 1].map(|k| {
        let scatter: f64 = at_zero.iter().map(|p| (p[k] - mean[k]).powi(2)).sum::<f64>() / (count * count);
        let by_matrix: f64 = (0..2).map(|axis| (matrix[k][axis].sigma * stands[axis]).powi(2)).sum();
        Measured { value: mean[k], sigma: (scatter + by_matrix).sqrt() }
    })
}

/// The readback relative to the commands.
fn readback(recording: &Recording) -> Option<[Readback; 2]> {
    let rest: Vec<StagePosition> =
        recording.looks.get(..recording.rest)?.iter().filter_map(|look| look.readback).collect();
    let noise = observation::noise(&rest)?;
    let of = |axis: usize| {
        let (mut forth, mut back, mut off) = (Vec::new(), Vec::new(), Vec::new());
        for step in recording.steps.iter().filter(|step| step.axis == axis) {
            let read =
                observation::mean(settled(recording, step).iter().filter_map(|look| look.readback))?[axis];
            off.push(read - step.to[axis]);
            if step.forth { forth.push(read) } else { back.push(read) }
        }
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let settled_looks = (recording.plan.dwell / 2 * recording.plan.steps as usize / 2) as f64;
        Some(Readback {
            scale: Measured {
                value: (mean(&forth) - mean(&back)) / recording.plan.step,
                sigma: noise[axis] * (2.0 / settled_looks).sqrt() / recording.plan.step,
            },
            offset: mean(&off),
            noise: noise[axis],
        })
    };
    Some([of(0)?, of(1)?])
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// The mean of two numbers, weighted by their standard uncertainties.
fn mean([(a, a_sigma), (b, b_sigma)]: [(f64, f64); 2]) -> Measured {
    let weight = |sigma: f64| 1.0 / (sigma * sigma).max(1e-30);
    let (p, q) = (weight(a_sigma), weight(b_sigma));
    Measured { value: (a * p + b * q) / (p + q), sigma: (p + q).sqrt().recip() }
}
