//! Runs the experiment on the digital twin: the daemon's code in lockstep, with the loop closed and the
//! true position as reference.

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

/// Time without a usable pose after which the measurement fails, seconds of the twin.
const POSE_TIMEOUT_S: f64 = 5.0;
/// Number of samples in which the mirror moves to the next point. A jump could be taken for noise.
const WAY: u32 = 64;

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
    why: String,
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
    /// The twin of a configuration, with the mirror at rest. Poses are in the sensor's world frame.
    ///
    /// # Errors
    /// Fails if the configuration is not valid.
    pub fn new(config: &Config) -> Result<Self, Failure> {
        let config = Config { frames: FramesConfig::default(), ..config.clone() };
        let mut sim = ClosedLoopSim::new(&config)?;
        sim.place(Pose::default());
        let rate_hz = config.acquisition.rate_hz;
        let average = u32::from(config.estimation.average);
        // Blocks that began before the movement are discarded, and the loop must have locked again.
        let settle = (config.centering.lock_time_ms * 1e-3 * rate_hz).ceil() as u64 + u64::from(average);
        let patience = (POSE_TIMEOUT_S * rate_hz).ceil() as u64 + 2 * settle;
        Ok(Self { sim, at: [0.0; 6], settle, calm: 0, patience, rate_hz, average, why: String::new() })
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
        let failed =
            |why| Failure::new(exit::UNAVAILABLE, format!("at rest: {why}; --rest 0 omits this record"));
        let mut last: Option<Observation> = None;
        for _ in 0..poses {
            let look = self.look().map_err(failed)?;
            if let Some(why) = last.and_then(|last| static_record::parted(&last, &look, period_s)) {
                let at_s = look.time_ns as f64 * 1e-9;
                return Err(failed(format!("{why}, at {at_s:.3} s; last reason: {}", self.why)));
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
        Err(format!("no usable pose for {POSE_TIMEOUT_S} s: {}", self.why))
    }
}

/// Converts a report to an observation, or returns why it is not usable.
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
        sigmas: std::array::from_fn(|i| covariance[(i, i)].sqrt() as f32),
        averaged: report.averaged.into(),
        config: report.config,
        status: report.status,
    })
}

/// Why a pose is not usable, as text.
pub(super) fn why_not(status: Status, lock: LockState) -> String {
    let names: Vec<_> = status.names().filter(|n| *n != "SIMULATED" && *n != "UNCALIBRATED").collect();
    let pose = if status.has(Status::POSE_VALID) { "the pose is valid" } else { "the pose is invalid" };
    format!("{pose}, the loop is {} ({})", lock.name(), names.join(" "))
}
