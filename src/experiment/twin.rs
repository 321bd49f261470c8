//! Runs the experiment on the digital twin: the daemon's code in lockstep, with the loop closed and the
//! true position as reference.

use std::fmt::Display;

use trifacet_core::estimation::PoseReport;
use trifacet_optics::Pose;
use trifacet_wire::{LockState, Status};

use super::observation::{Mean, Observation, at_rest};
use super::protocol::Protocol;
use super::reading::{Part, Reading};
use super::{place, static_record};
use crate::closed_loop_sim::ClosedLoopSim;
use crate::config::{Axis, Config, FramesConfig, TransformConfig};
use crate::exit::{self, Failure};

/// Time without a usable pose after which the measurement fails, seconds of the twin.
const POSE_TIMEOUT_S: f64 = 5.0;
/// Number of samples in which the mirror moves to the next point. A jump could be taken for noise.
const WAY: u32 = 64;

/// Why a pose is not usable: the pose is invalid, or the loop is not locked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the pose is {}, the loop is {} ({})",
    if status.has(Status::POSE_VALID) { "valid" } else { "invalid" }, lock.name(), causes(*status)
)]
pub struct UnusablePose {
    /// Status bits of the pose.
    pub status: Status,
    /// State of the loop.
    pub lock: LockState,
}

/// The names of the status bits, without those that do not make a pose unusable.
fn causes(status: Status) -> String {
    let names = status.names().filter(|name| *name != "SIMULATED" && *name != "UNCALIBRATED");
    names.collect::<Vec<_>>().join(" ")
}

/// There was no usable pose in time.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("no usable pose for {POSE_TIMEOUT_S} s: {}", reason(*last))]
struct PoseTimeout {
    /// Why the last pose was not usable.
    last: Option<UnusablePose>,
}

/// Why a pose was not usable. Empty: there was no such pose.
fn reason(unusable: Option<UnusablePose>) -> String {
    unusable.as_ref().map_or_else(String::new, UnusablePose::to_string)
}

/// The bench of the paper as a twin.
pub struct Bench {
    sim: ClosedLoopSim,
    /// Position of the mirror, metres and radians.
    at: [f64; 6],
    /// Number of samples for which all poses must have been usable before one is taken.
    settle: u64,
    /// Number of samples for which this has been the case.
    calm: u64,
    /// Number of samples after which the measurement fails.
    patience: u64,
    rate_hz: f64,
    average: u32,
    /// Why the last pose was not usable.
    unusable: Option<UnusablePose>,
}

/// The configuration beyond the paper: an 18-bit converter, less spot noise, means of a hundred samples.
#[must_use]
pub fn beyond(config: &Config) -> Config {
    let mut config = config.clone();
    config.twin.converter_bits = 18;
    config.twin.spot_noise_um = 0.57;
    config.estimation.spot_noise_um = 0.57;
    config.estimation.average = 100;
    config
}

impl Bench {
    /// The twin of a configuration, with the mirror at rest. Poses are in the sensor's world frame; for a head of its
    /// own, in the axes of its stage, as far as `[frames]` describes them.
    ///
    /// # Errors
    /// Fails if the configuration is not valid.
    pub fn new(config: &Config) -> Result<Self, Failure> {
        let base_and_tool = FramesConfig { tare: TransformConfig::default(), ..config.frames };
        let frames = if config.twin.has_own_head() { base_and_tool } else { FramesConfig::default() };
        let config = Config { frames, ..config.clone() };
        let mut sim = ClosedLoopSim::new(&config)?;
        sim.place(Pose::default());
        let rate_hz = config.acquisition.rate_hz;
        let average = u32::from(config.estimation.average);
        // Blocks that began before the movement are discarded, and the loop must have locked again.
        let settle = (config.centering.lock_time_ms * 1e-3 * rate_hz).ceil() as u64 + u64::from(average);
        let patience = (POSE_TIMEOUT_S * rate_hz).ceil() as u64 + 2 * settle;
        Ok(Self { sim, at: [0.0; 6], settle, calm: 0, patience, rate_hz, average, unusable: None })
    }

    /// Takes all readings of a protocol. `taken` is called after every reading.
    ///
    /// # Errors
    /// Fails if a reading cannot be taken. The message contains the point and the reason.
    pub fn measure(
        &mut self,
        protocol: &Protocol,
        part: Part,
        taken: &mut dyn FnMut(),
    ) -> Result<Vec<Reading>, Failure> {
        let mut readings = Vec::new();
        for course in &protocol.courses {
            let axis = course.axis;
            for (point, reference) in (1..).zip(&course.points) {
                self.place(axis, *reference);
                for number in 1..=protocol.readings {
                    let look = self.look().map_err(|why| {
                        let (name, unit, of) = (axis.name(), axis.micro_unit(), course.points.len());
                        let at =
                            format!("{name} point {point} of {of}, at {} {unit}", place(reference * 1e6));
                        Failure::new(exit::UNAVAILABLE, format!("{at}, reading {number}: {why}"))
                    })?;
                    readings.push(Reading { part, moved: Some((axis, *reference)), point, number, look });
                    taken();
                }
            }
        }
        Ok(readings)
    }

    /// Takes a record of `seconds` seconds with the mirror at rest.
    ///
    /// # Errors
    /// Fails if a reading cannot be taken, or if there is a gap between two.
    pub fn rest(&mut self, seconds: f64) -> Result<Vec<Reading>, Failure> {
        self.place(Axis::Tx, 0.0);
        let poses = (seconds * self.rate_hz / f64::from(self.average)) as u64;
        let of = at_rest(poses);
        let mut mean = Mean::default();
        let mut readings = Vec::new();
        let period_s = f64::from(self.average) / self.rate_hz;
        let failed = |why: &dyn Display| {
            Failure::new(exit::UNAVAILABLE, format!("at rest: {why}; --rest 0 omits this record"))
        };
        let mut last: Option<Observation> = None;
        for _ in 0..poses {
            let look = self.look().map_err(|error| failed(&error))?;
            if let Some(why) = last.and_then(|last| static_record::parted(&last, &look, period_s)) {
                let at_s = look.time_ns as f64 * 1e-9;
                let last = reason(self.unusable);
                return Err(failed(&format_args!("{why}, at {at_s:.3} s; last reason: {last}")));
            }
            last = Some(look);
            if let Some(look) = mean.push(&look, of) {
                let number = readings.len() as u32 + 1;
                readings.push(Reading { part: Part::StaticRecord, moved: None, point: 0, number, look });
            }
        }
        Ok(readings)
    }

    /// Moves the mirror to a position of this axis, with all other axes at zero.
    fn place(&mut self, axis: Axis, amount: f64) {
        let mut to = [0.0; 6];
        to[axis as usize] = amount;
        for k in 1..=WAY {
            let part = f64::from(k) / f64::from(WAY);
            let pose = std::array::from_fn(|i| self.at[i] + part * (to[i] - self.at[i]));
            self.sim.place(Pose::from_array(pose));
            self.sim.step();
        }
        (self.at, self.calm) = (to, 0);
    }

    /// The next usable pose: valid and locked, like all poses since the mirror settled.
    fn look(&mut self) -> Result<Observation, PoseTimeout> {
        for _ in 0..self.patience {
            let Some(report) = self.sim.step().report else { continue };
            match look(&report) {
                Ok(look) => {
                    self.calm += u64::from(look.averaged);
                    if self.calm > self.settle {
                        return Ok(look);
                    }
                }
                Err(unusable) => (self.calm, self.unusable) = (0, Some(unusable)),
            }
        }
        Err(PoseTimeout { last: self.unusable })
    }
}

/// Converts a report to an observation, or returns why it is not usable.
fn look(report: &PoseReport) -> Result<Observation, UnusablePose> {
    let unusable = UnusablePose { status: report.status, lock: report.lock };
    let (pose, covariance) = report.pose.zip(report.covariance).ok_or(unusable)?;
    if report.lock != LockState::Locked {
        return Err(unusable);
    }
    Ok(Observation {
        time_ns: report.time.0,
        pose: pose.to_array(),
        sigmas: std::array::from_fn(|i| covariance[(i, i)].sqrt() as f32),
        averaged: report.averaged.into(),
        config: report.config,
        status: report.status,
    })
}
