//! The estimation: samples to pose reports. Pure: time and loop state are inputs.

use serde::{Deserialize, Serialize};
use trifacet_optics::{ErrorPropagation, Innovation, Model, Noise, Signals, Solution, SolveError};
use trifacet_wire::{LockState, Status};

use super::block::{Block, Mean};
use super::integrity::Integrity;
use super::noise::LiveNoise;
use super::power_step::{Power, PowerSteps};
use super::{PoseReport, Settings};
use crate::centering::LoopState;
use crate::estimation::signal_checks as light;
use crate::signals::{PsdState, Sample};
use crate::time::Mono;

/// In a mean of at least this many samples, one sample with an unsteady power does no harm.
const DILUTED: u16 = 4;

/// Turns samples into reports.
#[derive(Clone, Debug)]
pub struct Estimation {
    settings: Settings,
    memory: EstimatorState,
}

/// State of the estimation. With the same state and the same settings, the same samples give the same
/// reports, bit by bit. The state is therefore recorded from time to time.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct EstimatorState {
    noise: LiveNoise,
    power_steps: PowerSteps,
    integrity: Integrity,
    block: Block,
    warm: Option<Solution>,
    /// The light is simulated, not measured.
    simulated: bool,
    index: u64,
}

impl Estimation {
    /// An estimation without any sample.
    pub fn new(settings: Settings) -> Self {
        Self { settings, memory: EstimatorState::default() }
    }

    /// The current state.
    pub fn memory(&self) -> &EstimatorState {
        &self.memory
    }

    /// Continues from this state.
    pub fn remember(&mut self, memory: EstimatorState) {
        self.memory = memory;
    }

    /// Uses other settings from the next sample on. Samples from before and after are not averaged together.
    pub fn retune(&mut self, settings: Settings) {
        if settings.readback != self.settings.readback {
            self.memory.integrity = Integrity::default();
        }
        self.settings = settings;
        self.interrupt();
        self.memory.warm = None;
    }

    /// As [`Settings::fuses`].
    pub fn fuses(&self) -> bool {
        self.settings.fuses()
    }

    /// Marks the end of a contiguous series of samples.
    fn interrupt(&mut self) {
        self.memory.block.clear();
        self.memory.noise.interrupt();
        self.memory.power_steps.interrupt();
    }

    /// A report as published: in the user's frame.
    pub fn in_user_frame(&self, report: &PoseReport) -> PoseReport {
        let Some(sensor) = report.pose else { return *report };
        let frames = &self.settings.frames;
        let user = frames.pose(&sensor);
        let covariance = user.zip(report.covariance).map(|(user, c)| frames.covariance(&sensor, &user, &c));
        let mut status = report.status;
        if user.is_none() {
            status.0 &= !Status::POSE_VALID.0;
            status |= Status::OUT_OF_RANGE;
        }
        PoseReport { pose: user, covariance, status, ..*report }
    }

    /// Records that a source is up.
    pub fn source(&mut self, simulated: bool) {
        self.memory.simulated = simulated;
        self.interrupt();
        self.memory.integrity = Integrity::default();
    }

    /// Takes a sample; returns a report at the end of each block. The caller adds the time at which the
    /// report was solved.
    pub fn sample(&mut self, sample: &Sample, steering: &LoopState) -> Option<PoseReport> {
        self.memory.index = sample.index;
        let good = sample.psds.iter().all(|psd| *psd == PsdState::Good);
        if sample.lost > 0 || !good {
            self.memory.noise.interrupt();
            self.memory.power_steps.interrupt();
        }
        let power = if good { self.power(sample) } else { Power::Steady };
        if power == Power::Step && !self.memory.power_steps.unsteady() {
            self.memory.noise.interrupt(); // a step is not noise
        } else if good {
            let [a, b, c, d, e, f] = sample.spots;
            let [p, q, r] = sample.powers;
            self.memory.noise.push([a, b, c, d, e, f, p, q, r]);
        }
        let mean = self.memory.block.push(sample, power, self.settings.average)?;
        Some(self.report(&mean, steering))
    }

    /// State of the total power of a sample, judged by the configured standard uncertainty, or by the live
    /// one where that is larger.
    fn power(&mut self, sample: &Sample) -> Power {
        let configured = self.settings.power_noise;
        let each = (6..).zip(sample.powers).map(|(i, power)| self.memory.noise.sigma(i, configured * power));
        let sigma = each.map(|sigma| sigma * sigma).sum::<f64>().sqrt();
        self.memory.power_steps.push(sample.powers.iter().sum(), sigma)
    }

    /// The report for a moment without samples.
    pub fn silence(&mut self, now: Mono, steering: &LoopState) -> PoseReport {
        self.interrupt();
        let nothing = Sample {
            index: self.memory.index,
            time: now,
            time_sigma_ns: None,
            lost: 0,
            spots: [f64::NAN; 6],
            powers: [f64::NAN; 3],
            psds: [PsdState::Good; 3],
            steering: None,
            output_railed: false,
            applied: None,
        };
        let mean = Mean { sample: nothing, count: 0, gap: false, power: Power::Steady };
        let mut report = self.blank(&mean, &steering.without_observation());
        report.status |= Status::SOURCE_DOWN;
        report
    }

    fn report(&mut self, mean: &Mean, steering: &LoopState) -> PoseReport {
        let mut report = self.blank(mean, steering);
        let noise = self.stated_noise(mean);
        if light::judge(&self.settings, mean, &noise, &mut report.status) {
            report.lock = report.lock.without_observation();
            report.status.set(Status::NOT_LOCKED, true);
            return report;
        }
        if mean.gap {
            return report;
        }
        let signals = Signals { spots: mean.sample.spots, powers: mean.sample.powers };
        let solved = self.settings.estimator.solve(&signals, self.memory.warm.as_ref());
        if let Err(error) = solved.and_then(|solution| self.solved(solution, mean, &noise, &mut report)) {
            self.memory.warm = None;
            report.iterations = error.iterations();
            report.status |= light::reason(&error);
        }
        if let Some(covariance) = &mut report.covariance {
            for (i, sigma) in self.settings.systematic.iter().enumerate() {
                covariance[(i, i)] += sigma * sigma;
            }
        }
        report
    }

    /// A report without a pose.
    fn blank(&self, mean: &Mean, steering: &LoopState) -> PoseReport {
        let sample = &mean.sample;
        let railed = sample.output_railed || steering.lock == LockState::Railed;
        let mut status = self.settings.fixed;
        status.set(Status::SIMULATED, self.memory.simulated);
        status.set(Status::SAMPLE_GAP, sample.lost > 0);
        status.set(Status::NOT_LOCKED, steering.lock != LockState::Locked);
        status.set(Status::STEERING_RAILED, railed);
        status.set(Status::STEERING_MEASURED, sample.steering.is_some());
        PoseReport {
            index: sample.index,
            time: sample.time,
            time_sigma_ns: sample.time_sigma_ns,
            solved: sample.time,
            status,
            config: self.settings.config,
            lock: steering.lock,
            pose: None,
            covariance: None,
            offset: None,
            steering_residual: None,
            iterations: 0,
            averaged: mean.count,
            lost: sample.lost,
            spots: sample.spots,
            powers: sample.powers,
            steering: sample.steering.or(steering.position.map(Into::into)),
        }
    }

    /// Standard uncertainties of the signals of a block: configured, or live where that is larger.
    fn stated_noise(&self, mean: &Mean) -> Noise {
        let quieter = f64::from(mean.count.max(1)).sqrt();
        let Settings { spot_noise, power_noise, .. } = self.settings;
        let live = |signal, configured| self.memory.noise.sigma(signal, configured) / quieter;
        Noise {
            spots: std::array::from_fn(|i| live(i, spot_noise)),
            powers: std::array::from_fn(|i| live(6 + i, power_noise * mean.sample.powers[i].abs())),
        }
    }

    fn solved(
        &mut self,
        solution: Solution,
        mean: &Mean,
        noise: &Noise,
        report: &mut PoseReport,
    ) -> Result<(), SolveError> {
        let estimator = &self.settings.estimator;
        let spread = estimator.sensitivity(&solution)?.spread(noise);
        report.status |= Status::POSE_VALID;
        report.pose = Some(solution.pose);
        report.covariance = Some(spread.pose_covariance());
        report.iterations = solution.iterations;
        if estimator.model() == Model::Gaussian {
            report.offset = Some(solution.offset.into());
            self.sighted(mean, &solution, &spread, report);
        }
        self.memory.warm = Some(solution);
        Ok(())
    }

    /// Compares the beam position from the readback of the stage with the solution. A readback that does not
    /// fit is not fused. Nor is one with changing powers: the fused pose depends on the powers more than its
    /// stated uncertainty shows.
    fn sighted(
        &mut self,
        mean: &Mean,
        solution: &Solution,
        spread: &ErrorPropagation<9>,
        report: &mut PoseReport,
    ) {
        let Settings { estimator, readback, fuse, .. } = &self.settings;
        let Some(beam_position) = mean.sample.steering.map(|stage| readback.beam_position(stage)) else {
            return;
        };
        let Some(innovation) = Innovation::new(estimator.optics(), solution, spread, &beam_position) else {
            return;
        };
        report.steering_residual = Some(innovation.residual.norm());
        let fits = self.memory.integrity.judge(&innovation);
        report.status.set(Status::INCONSISTENT, self.memory.integrity.inconsistent());
        let calm = mean.power == Power::Steady || mean.count >= DILUTED;
        if *fuse && fits && calm {
            let fused = innovation.fuse(solution);
            report.pose = Some(fused.pose);
            report.covariance = Some(fused.spread.pose_covariance());
            report.offset = Some(fused.offset.into());
        }
    }
}
