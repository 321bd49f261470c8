//! Which steps are safe: within the limits of the stage, small beside the beam, large beside the noise.

use trifacet_core::centering::OnExit;
use trifacet_core::steering::Xy;
use trifacet_wire::actuator::LeaseAction;

use super::observation::{self, Observation};
use crate::config::Config;
use crate::exit::{self, Failure};

/// A step by default at most, and a fraction of the beam's deviation: well within where its offset is
/// measured well.
const STEP: f64 = 20e-6;
const STEP_OF_BEAM: f64 = 0.2;
/// The beam with its steps must stay within so many of its deviations of the apex at the start ...
const NEAR: f64 = 1.0;
/// ... and within so many all the time.
const FAR: f64 = 1.5;
/// A step must be so many times what the offset does by itself.
const ABOVE_UNREST: f64 = 4.0;
/// Windows without a lost sample that must be left of all.
pub(super) const USED: f64 = 0.8;
/// A single step is watched for so many dwells, and so many seconds at least.
const WATCHED: usize = 10;
const WATCHED_S: f64 = 1.0;

/// What a person may choose.
#[derive(Clone, Copy, Debug)]
pub struct Choices {
    /// Length of a step, metres; by default one that fits beam and stage.
    pub step: Option<f64>,
    /// Steps of each axis.
    pub steps: u32,
    /// How long the stage stays after each, seconds; by default what fits the configured delay.
    pub dwell: Option<f64>,
    /// Where a stage without readback stands, metres.
    pub at: Option<Xy>,
}

/// What the configuration says, and a person.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    choices: Choices,
    /// Samples that the stage stays after each step.
    pub dwell: usize,
    /// Samples at rest before anything moves.
    pub rest: usize,
    /// Seconds between samples.
    pub period: f64,
    beam_sigma: f64,
    limit: f64,
    slew: f64,
    park: Option<Xy>,
    /// The lease of every command, milliseconds.
    pub lease_ms: u16,
    /// What happens when it ends.
    pub on_expiry: LeaseAction,
}

/// What will be done.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Where the stage stands, metres.
    pub found: Xy,
    /// Where it stands at the end.
    pub end: Xy,
    /// Length of a step, metres: each axis goes half of it to either side.
    pub step: f64,
    /// Steps of each axis.
    pub steps: u32,
    /// Samples after each step.
    pub dwell: usize,
    /// Samples for which the first step of each axis is watched.
    pub watch: usize,
    /// How long all of it takes, seconds.
    pub duration: f64,
    /// Plus and minus, metres.
    pub limit: f64,
    /// The beam may not be farther from the apex than this, metres.
    pub reach: f64,
    /// The mean offset of the beam at rest, metres.
    pub offset: Xy,
    /// White noise of the offset at rest, metres.
    pub noise: Xy,
}

impl Settings {
    /// From a checked configuration, for a beam of this deviation.
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
            park: (steering.on_exit == OnExit::Park).then(|| steering.park_um.map(|um| um * 1e-6)),
            lease_ms: steering.lease_ms,
            on_expiry: match steering.on_lease {
                OnExit::Hold => LeaseAction::Hold,
                OnExit::Park => LeaseAction::Park,
            },
        }
    }

    /// The steps that are safe after this rest, in which the stage said last that it stands `at`; or why
    /// there are none.
    pub fn plan(&self, rest: &[Observation], at: Option<Xy>) -> Result<Plan, Failure> {
        let offsets: Vec<Xy> = rest.iter().map(|look| look.offset).collect();
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
                 bring it nearer first",
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
                 take a larger --step, or quieten light and mirror",
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
            noise,
        })
    }

    /// Commands stay within plus and minus this, metres.
    pub fn limit(&self) -> f64 {
        self.limit
    }

    /// Samples of a window around a step.
    pub fn window(&self) -> usize {
        self.dwell + self.dwell / 2
    }

    /// Enough windows must be without a lost sample, or too few steps could be used.
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
            "{lost} samples were lost while {came} came: of 100 stretches of {:.0} ms, which a step needs, {} are \
             without a loss, needed are {:.0}",
            self.window() as f64 * self.period * 1e3,
            100 * whole / all.max(1),
            USED * 100.0
        )))
    }

    /// Where the stage stands: by its readback, by what it said, or by what a person says.
    fn found(&self, rest: &[Observation], said: Option<Xy>) -> Result<Xy, Failure> {
        let read = observation::mean(rest.iter().filter_map(|look| look.readback)).or(said);
        match (read, self.choices.at) {
            (Some(_), Some(_)) => {
                Err(refused("--at is for a stage without readback; this one says where it stands"))
            }
            (Some(at), None) | (None, Some(at)) => Ok(at),
            (None, None) => Err(refused(
                "the stage does not say where it stands, and the first command could make it jump: \
                 say where it was sent last with --at X_UM,Y_UM; it is sent there first",
            )),
        }
    }

    fn step(&self) -> Result<f64, Failure> {
        let most = self.slew * self.period;
        match self.choices.step {
            Some(step) if step > most * (1.0 + 1e-9) => Err(refused(format!(
                "a step of {} um from one sample to the next is faster than steering.slew_mm_per_s, {}; allowed are {} um",
                um(step),
                self.slew * 1e3,
                um(most)
            ))),
            Some(step) => Ok(step),
            None => Ok(STEP.min(STEP_OF_BEAM * self.beam_sigma).min(most)),
        }
    }
}

/// Nothing has been moved, or nothing more is: with the reason.
pub(super) fn refused(why: impl Into<String>) -> Failure {
    Failure::new(exit::DATA, why)
}

/// Micrometres, to 0.01, without a negative zero.
pub fn um(metres: f64) -> f64 {
    (metres * 1e8).round() / 100.0 + 0.0
}
