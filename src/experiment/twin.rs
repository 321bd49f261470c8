//! The experiment on the digital twin: the daemon's cores in lockstep, the loop closed, the twin's truth for
//! the reference.

use trifacet_core::estimation::PoseReport;
use trifacet_optics::Pose;
use trifacet_wire::{LockState, Status};

use super::observation::{Mean, Observation, at_rest};
use super::protocol::Protocol;
use super::reading::{Part, Reading};
use super::{place, static_record};
use crate::closed_loop_sim::ClosedLoopSim;
use crate::config::{Axis, Config, FramesConfig};
use crate::exit::{self, Failure};

/// Without a pose that counts for so long, seconds of the twin, there will be none.
const POSE_TIMEOUT_S: f64 = 5.0;
/// Samples that the mirror takes from point to point: a jump would be taken for noise, as that of a stage is not.
const WAY: u32 = 64;

/// The paper's bench, as a twin.
pub struct Bench {
    sim: ClosedLoopSim,
    /// Where the mirror stands, metres and radians.
    at: [f64; 6],
    /// Samples for which poses must count, one after the other, before one is taken.
    settle: u64,
    /// Samples for which that has been so.
    calm: u64,
    /// Samples after which there is no hope.
    patience: u64,
    rate_hz: f64,
    average: u32,
    /// Why the last pose did not count.
    why: String,
}

/// What the design reaches beyond the paper: another converter, quieter detectors, means of a hundred samples.
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
    /// The twin of a configuration, with the mirror at rest, told in the sensor's own frame.
    ///
    /// # Errors
    /// What would keep the daemon from starting.
    pub fn new(config: &Config) -> Result<Self, Failure> {
        let config = Config { frames: FramesConfig::default(), ..config.clone() };
        let mut sim = ClosedLoopSim::new(&config)?;
        sim.place(Pose::default());
        let rate_hz = config.acquisition.rate_hz;
        let average = u32::from(config.estimation.average);
        // What was begun before the mirror moved does not count, nor how the loop comes after it.
        let settle = (config.centering.lock_time_ms * 1e-3 * rate_hz).ceil() as u64 + u64::from(average);
        let patience = (POSE_TIMEOUT_S * rate_hz).ceil() as u64 + 2 * settle;
        Ok(Self { sim, at: [0.0; 6], settle, calm: 0, patience, rate_hz, average, why: String::new() })
    }

    /// Goes through a protocol; `taken` hears of every reading.
    ///
    /// # Errors
    /// A reading cannot be had: where, and why.
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

    /// The mirror at rest for so many seconds.
    ///
    /// # Errors
    /// A reading cannot be had, or there is a hole between two: why.
    pub fn rest(&mut self, seconds: f64) -> Result<Vec<Reading>, Failure> {
        self.place(Axis::Tx, 0.0);
        let poses = (seconds * self.rate_hz / f64::from(self.average)) as u64;
        let of = at_rest(poses);
        let mut mean = Mean::default();
        let mut readings = Vec::new();
        let period_s = f64::from(self.average) / self.rate_hz;
        let failed = |why| Failure::new(exit::UNAVAILABLE, format!("at rest: {why}; --rest 0 does without"));
        let mut last: Option<Observation> = None;
        for _ in 0..poses {
            let look = self.look().map_err(failed)?;
            if let Some(why) = last.and_then(|last| static_record::parted(&last, &look, period_s)) {
                let at_s = look.time_ns as f64 * 1e-9;
                return Err(failed(format!("{why}, at {at_s:.3} s; before: {}", self.why)));
            }
            last = Some(look);
            if let Some(look) = mean.push(&look, of) {
                let number = readings.len() as u32 + 1;
                readings.push(Reading { part: Part::StaticRecord, moved: None, point: 0, number, look });
            }
        }
        Ok(readings)
    }

    /// Moves the mirror to where only this axis is off the middle.
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

    /// The next pose that counts: valid and locked, as were those before it since the mirror settled.
    fn look(&mut self) -> Result<Observation, String> {
        for _ in 0..self.patience {
            let Some(report) = self.sim.step().report else { continue };
            match look(&report) {
                Ok(look) => {
                    self.calm += u64::from(look.averaged);
                    if self.calm > self.settle {
                        return Ok(look);
                    }
                }
                Err(why) => (self.calm, self.why) = (0, why),
            }
        }
        Err(format!("no pose to count on for {POSE_TIMEOUT_S} s: {}", self.why))
    }
}

/// A report as a look, or why it does not count.
fn look(report: &PoseReport) -> Result<Observation, String> {
    let (Some(pose), Some(covariance)) = (report.pose, report.covariance) else {
        return Err(why_not(report.status, report.lock));
    };
    if report.lock != LockState::Locked {
        return Err(why_not(report.status, report.lock));
    }
    Ok(Observation {
        time_ns: report.time.0,
        pose: pose.to_array(),
        deviations: std::array::from_fn(|i| covariance[(i, i)].sqrt() as f32),
        averaged: report.averaged.into(),
        config: report.config,
        status: report.status,
    })
}

/// Why a pose does not count, in words for people.
pub(super) fn why_not(status: Status, lock: LockState) -> String {
    let names: Vec<_> = status.names().filter(|n| *n != "SIMULATED" && *n != "UNCALIBRATED").collect();
    let pose = if status.has(Status::POSE_VALID) { "the pose is valid" } else { "the pose is invalid" };
    format!("{pose}, the loop is {} ({})", lock.name(), names.join(" "))
}
