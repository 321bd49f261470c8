//! Chooses steps that are safe: within the limits of the stage, small relative to the beam, large relative to
//! the noise.

use trifacet_core::centering::OnExit;
use trifacet_core::steering::{BeamOffset, StagePosition};
use trifacet_wire::actuator::LeaseAction;

use super::observation::{self, Observation};
use crate::config::Config;
use crate::exit::{self, Failure};

/// Largest default step, metres, and as a fraction of the standard deviation of the beam profile. Both are
/// well within the range in which the offset is measured accurately.
const STEP: f64 = 20e-6;
const STEP_OF_BEAM: f64 = 0.2;
/// Largest distance of beam plus step from the apex at the start, in standard deviations of the beam profile.
const NEAR: f64 = 1.0;
/// The same limit during the measurement.
const FAR: f64 = 1.5;
/// A step must be at least this many times the rms variation of the offset at rest.
const ABOVE_UNREST: f64 = 4.0;
/// Least fraction of windows without a lost sample.
pub(super) const USED: f64 = 0.8;
/// Duration of observing a single step: this many dwell times, and at least this many seconds.
const WATCHED: usize = 10;
const WATCHED_S: f64 = 1.0;

/// Options of the operator.
#[derive(Clone, Copy, Debug)]
pub struct Choices {
    /// Length of a step, metres; by default one that suits beam and stage.
    pub step: Option<f64>,
    /// Steps per axis.
    pub steps: u32,
    /// Dwell time after each step, seconds; by default derived from the configured delay and lag.
    pub dwell: Option<f64>,
    /// Position of a stage without readback, metres.
    pub at: Option<StagePosition>,
}

/// Settings from the configuration and the options.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    choices: Choices,
    /// Dwell time after each step, in samples.
    pub dwell: usize,
    /// Number of samples at rest before the first movement.
    pub rest: usize,
    /// Sample period, seconds.
    pub period: f64,
    beam_sigma: f64,
    limit: f64,
    slew: f64,
    park: Option<StagePosition>,
    /// Lease of every command, milliseconds.
    pub lease_ms: u16,
    /// Action when the lease expires.
    pub on_expiry: LeaseAction,
}

/// The planned measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Initial position of the stage, metres.
    pub found: StagePosition,
    /// Final position of the stage, metres.
    pub end: StagePosition,
    /// Length of a step, metres. Each axis moves half of it to either side.
    pub step: f64,
    /// Steps per axis.
    pub steps: u32,
    /// Dwell time after each step, in samples.
    pub dwell: usize,
    /// Number of samples for which the first step of each axis is observed.
    pub watch: usize,
    /// Duration of the whole measurement, seconds.
    pub duration: f64,
    /// Limit of the stage, plus and minus, metres.
    pub limit: f64,
    /// Largest permitted distance of the beam from the apex, metres.
    pub reach: f64,
    /// Mean offset of the beam at rest, metres.
    pub offset: BeamOffset,
    /// Standard deviation of the white noise of the offset at rest, metres.
    pub noise: BeamOffset,
}

impl Plan {
    /// Position of the stage at one end of the steps of an axis; `forth`: the positive end.
    pub(super) fn end_of_step(&self, axis: usize, forth: bool) -> StagePosition {
        let mut to = self.found;
        to.0[axis] += if forth { self.step / 2.0 } else { -self.step / 2.0 };
        to
    }
}

impl Settings {
    /// Settings from a checked configuration. `beam_sigma`: standard deviation of the beam profile, metres.
    pub fn new(config: &Config, beam_sigma: f64, choices: Choices) -> Self {
        let (steering, centering) = (&config.steering, &config.centering);
        let rate = config.acquisition.rate_hz;
        let settled = 10.0e-3 * (centering.loop_delay_ms + centering.lag_ms);
        let dwell = (choices.dwell.unwrap_or(settled.max(0.05)) * rate).ceil();
        let dwell = (dwell as usize).max(20);
        Self {
            choices,
            dwell,
            rest: (rate.ceil() as usize).max(6 * dwell),
            period: 1.0 / rate,
            beam_sigma,
            limit: steering.limit_um * 1e-6,
            slew: steering.slew_mm_per_s * 1e-3,
            park: (steering.on_exit == OnExit::Park)
                .then(|| steering.park_um.map(|um| um * 1e-6))
                .map(StagePosition),
            lease_ms: steering.lease_ms,
            on_expiry: match steering.on_lease {
                OnExit::Hold => LeaseAction::Hold,
                OnExit::Park => LeaseAction::Park,
            },
        }
    }

    /// Plans safe steps after the observations `rest`. `at` is the last position that the stage reported.
    ///
    /// # Errors
    /// [`exit::DATA`] with the reason if no safe step exists: limits, position, noise or lost samples.
    pub fn plan(&self, rest: &[Observation], at: Option<StagePosition>) -> Result<Plan, Failure> {
        let offsets: Vec<BeamOffset> = rest.iter().map(|look| look.offset).collect();
        let (Some(offset), Some(noise)) =
            (observation::mean(offsets.iter().copied()), observation::noise(&offsets))
        else {
            return Err(refused("there are too few samples"));
        };
        self.losses(rest)?;
        let found = self.found(rest, at)?;
        let step = self.step()?;
        for (axis, found) in ["x", "y"].into_iter().zip(found) {
            let (from, to) = (found - step / 2.0, found + step / 2.0);
            if from < -self.limit || to > self.limit {
                return Err(refused(format!(
                    "the steps would leave the limits: the {axis} axis stands at {} um and would go from {} to {} um; \
                     steering.limit_um allows {} to {} um",
                    um(found),
                    um(from),
                    um(to),
                    um(-self.limit),
                    um(self.limit)
                )));
            }
        }
        let far = offset[0].hypot(offset[1]);
        if far + step > NEAR * self.beam_sigma {
            return Err(refused(format!(
                "the beam is {} um off the apex ({}, {}); with a step of {} um at most {} um can be measured well: \
                 move it closer to the apex first",
                um(far),
                um(offset[0]),
                um(offset[1]),
                um(step),
                um(NEAR * self.beam_sigma - step)
            )));
        }
        let unrest = observation::unrest(&offsets, self.window().min(offsets.len()));
        if step < ABOVE_UNREST * unrest {
            return Err(refused(format!(
                "the offset is not quiet enough: {} um rms about a straight course over {:.0} ms, and a step of {} um allows {} um; \
                 use a larger --step, or reduce the noise of the light and the vibration of the mirror",
                um(unrest),
                self.window() as f64 * self.period * 1e3,
                um(step),
                um(step / ABOVE_UNREST)
            )));
        }
        let watch = (WATCHED * self.dwell).max((WATCHED_S / self.period).ceil() as usize);
        let moves = 2.0 * (f64::from(self.choices.steps) + 4.0) + 1.0;
        Ok(Plan {
            found,
            end: self.park.unwrap_or(found),
            step,
            steps: self.choices.steps,
            dwell: self.dwell,
            watch,
            duration: (moves * self.dwell as f64 + 2.0 * watch as f64) * self.period,
            limit: self.limit,
            reach: FAR * self.beam_sigma,
            offset,
            noise: BeamOffset(noise),
        })
    }

    /// Limit of commands, plus and minus, metres.
    pub fn limit(&self) -> f64 {
        self.limit
    }

    /// Number of samples of a window around a step.
    pub fn window(&self) -> usize {
        self.dwell + self.dwell / 2
    }

    /// Checks that enough windows contain no lost sample.
    fn losses(&self, rest: &[Observation]) -> Result<(), Failure> {
        let came = rest.len() as u64;
        let lost =
            rest.first().zip(rest.last()).map_or(0, |(a, b)| (b.index + 1 - a.index).saturating_sub(came));
        let (mut all, mut whole) = (0_usize, 0_usize);
        for window in rest.windows(self.window()) {
            all += 1;
            whole += usize::from(observation::whole(window));
        }
        if whole as f64 >= USED * all as f64 {
            return Ok(());
        }
        Err(refused(format!(
            "{lost} samples were lost while {came} arrived: a step needs windows of {:.0} ms without a loss; {} of 100 \
             windows are without one, at least {:.0} are needed",
            self.window() as f64 * self.period * 1e3,
            100 * whole / all.max(1),
            USED * 100.0
        )))
    }

    /// Position of the stage: by its readback, as it reported it, or by the option `--at`.
    fn found(&self, rest: &[Observation], said: Option<StagePosition>) -> Result<StagePosition, Failure> {
        let read = observation::mean(rest.iter().filter_map(|look| look.readback)).or(said);
        match (read, self.choices.at) {
            (Some(_), Some(_)) => {
                Err(refused("--at is for a stage without readback; this one reports its position"))
            }
            (Some(at), None) | (None, Some(at)) => Ok(at),
            (None, None) => Err(refused(
                "the stage does not report its position, and the first command could make it jump: \
                 state its last commanded position with --at X_UM,Y_UM; the stage is sent there first",
            )),
        }
    }

    fn step(&self) -> Result<f64, Failure> {
        let most = self.slew * self.period;
        match self.choices.step {
            Some(step) if step > most * (1.0 + 1e-9) => Err(refused(format!(
                "a step of {} um from one sample to the next is faster than steering.slew_mm_per_s, {}; allowed: {} um",
                um(step),
                self.slew * 1e3,
                um(most)
            ))),
            Some(step) => Ok(step),
            None => Ok(STEP.min(STEP_OF_BEAM * self.beam_sigma).min(most)),
        }
    }
}

/// A failure with the reason for which the measurement does not begin, or ends.
pub(super) fn refused(why: impl Into<String>) -> Failure {
    Failure::new(exit::DATA, why)
}

/// Micrometres, rounded to 0.01, without a negative zero.
pub fn um(metres: f64) -> f64 {
    (metres * 1e8).round() / 100.0 + 0.0
}
