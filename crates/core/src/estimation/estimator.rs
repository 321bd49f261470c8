//! The estimation: samples to pose reports. Pure: time and loop state are inputs.

use std::sync::Arc;

use nalgebra::Matrix6;
use serde::{Deserialize, Deserializer, Serialize};
use trifacet_optics::{ErrorPropagation, Innovation, Model, Noise, Pose, Signals, Solution, SolveError};
use trifacet_wire::{LockState, Status};

use super::block::{Block, Mean};
use super::by_pose::Computed;
use super::exposure::{Doubt, Exposure};
use super::integrity::{Integrity, SlowResidual};
use super::noise::LiveNoise;
use super::power_noise::PowerNoise;
use super::power_step::{Power, PowerHistory, PowerSteps};
use super::{PoseReport, Settings};
use crate::centering::LoopState;
use crate::estimation::signal_checks as light;
use crate::signals::{Identity, PsdState, Sample};
use crate::time::Mono;

/// In a mean of at least this many samples, one sample with an unsteady power does no harm.
const DILUTED: u16 = 4;

/// Turns samples into reports.
#[derive(Clone, Debug)]
pub struct Estimation {
    settings: Settings,
    source: Option<Arc<Identity>>,
    exposure: Exposure,
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
    /// `None` before the first residual, and in recordings of versions that did not have it. The last four fields must
    /// remain the last, in this order: recordings of earlier versions end before them.
    #[serde(deserialize_with = "if_recorded")]
    slow: Option<SlowResidual>,
    /// What was learnt of the powers.
    #[serde(deserialize_with = "powers_if_recorded")]
    powers: PowerMemory,
    /// Whether a sample of the block has a spot that no measurement covers. `None` before the first sample, and in
    /// recordings of versions that did not test it.
    #[serde(deserialize_with = "if_recorded")]
    uncovered: Option<bool>,
    /// The systematic part that depends on the pose, as last computed. `None` where the settings have no such part, and
    /// in recordings of versions without it.
    #[serde(deserialize_with = "if_recorded")]
    by_pose: Option<Computed>,
}

/// What was learnt of the powers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct PowerMemory {
    history: PowerHistory,
    noise: PowerNoise,
    /// Sum over the samples of the block.
    doubt: Doubt,
    /// Version 0.1.0 recorded the state, without this part. A replay then judges the powers as that version did, and
    /// gives the same poses, bit by bit.
    unrecorded: bool,
}

/// The value, or none where the data end before it. Postcard does not mark the end of a struct: reading beyond the
/// end of the message is an error.
#[expect(clippy::unnecessary_wraps, reason = "the signature that serde expects")]
fn if_recorded<'de, D: Deserializer<'de>, T: Deserialize<'de>>(from: D) -> Result<Option<T>, D::Error> {
    Ok(Option::deserialize(from).unwrap_or_default())
}

#[expect(clippy::unnecessary_wraps, reason = "the signature that serde expects")]
fn powers_if_recorded<'de, D: Deserializer<'de>>(from: D) -> Result<PowerMemory, D::Error> {
    let nothing = |_| PowerMemory { unrecorded: true, ..PowerMemory::default() };
    Ok(PowerMemory::deserialize(from).unwrap_or_else(nothing))
}

impl EstimatorState {
    /// Whether the state includes the mean residual. States of earlier versions do not.
    pub fn has_mean_residual(&self) -> bool {
        self.slow.is_some()
    }

    /// Whether the version of the state tested that measurements cover the spots.
    pub fn has_coverage(&self) -> bool {
        self.uncovered.is_some()
    }

    /// The state without what `other` does not include.
    #[must_use]
    pub fn as_far_as(&self, other: &Self) -> Self {
        Self {
            slow: self.slow.filter(|_| other.has_mean_residual()),
            uncovered: self.uncovered.filter(|_| other.has_coverage()),
            ..self.clone()
        }
    }
}

impl Estimation {
    /// An estimation without any sample.
    pub fn new(settings: Settings) -> Self {
        Self { settings, source: None, exposure: Exposure::default(), memory: EstimatorState::default() }
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
            self.forget_residuals();
        }
        self.settings = settings;
        self.expose();
        self.interrupt();
        (self.memory.warm, self.memory.by_pose) = (None, None);
    }

    /// As [`Settings::fuses`].
    pub fn fuses(&self) -> bool {
        self.settings.fuses()
    }

    /// Marks the end of a contiguous series of samples.
    fn interrupt(&mut self) {
        self.memory.block.clear();
        self.memory.powers.doubt = Doubt::default();
        self.memory.uncovered = self.memory.uncovered.map(|_| false);
        self.interrupt_signals();
    }

    /// The next sample does not follow the last one.
    fn interrupt_signals(&mut self) {
        let EstimatorState { noise, power_steps, powers, .. } = &mut self.memory;
        noise.interrupt();
        powers.noise.interrupt();
        power_steps.interrupt(&mut powers.history);
    }

    /// The last report as published: in the user's frame, with the systematic part that depends on the pose.
    pub fn in_user_frame(&self, report: &PoseReport) -> PoseReport {
        let Some(sensor) = report.pose else { return *report };
        let frames = &self.settings.frames;
        let user = frames.pose(&sensor);
        let both = user.zip(report.covariance).map(|(user, c)| {
            let systematic = self.systematic(&sensor, &user);
            let by_pose = self.memory.by_pose.as_ref().map_or_else(Matrix6::zeros, |c| c.covariance);
            (frames.covariance(&sensor, &user, &c) + by_pose, systematic + by_pose)
        });
        let mut status = report.status;
        if user.is_none() {
            status.0 &= !Status::POSE_VALID.0;
            status |= Status::OUT_OF_RANGE;
        }
        let (covariance, systematic) = both.unzip();
        PoseReport { pose: user, covariance, systematic, status, ..*report }
    }

    /// The systematic part that is the same at every pose, in the user's frame.
    fn systematic(&self, sensor: &Pose, user: &Pose) -> Matrix6<f64> {
        let Settings { systematic, frames, .. } = &self.settings;
        if *systematic == [0.0; 6] {
            return Matrix6::zeros();
        }
        let own = Matrix6::from_diagonal(&systematic.map(|sigma| sigma * sigma).into());
        frames.covariance(sensor, user, &own)
    }

    /// Records that a source is up.
    pub fn source(&mut self, identity: Arc<Identity>) {
        self.memory.simulated = identity.simulated;
        self.source = Some(identity);
        self.expose();
        self.interrupt();
        self.forget_residuals();
    }

    fn forget_residuals(&mut self) {
        (self.memory.integrity, self.memory.slow) = (Integrity::default(), None);
    }

    fn expose(&mut self) {
        let of = |identity: &Arc<Identity>| Exposure::new(identity, self.settings.amplifiers);
        self.exposure = self.source.as_ref().map(of).unwrap_or_default();
    }

    /// Takes a sample; returns a report at the end of each block. The caller adds the time at which the
    /// report was solved.
    pub fn sample(&mut self, sample: &Sample, steering: &LoopState) -> Option<PoseReport> {
        self.memory.index = sample.index;
        let good = sample.psds.iter().all(|psd| *psd == PsdState::Good);
        if sample.lost > 0 || !good {
            self.interrupt_signals();
        }
        let (power, doubt) = if good { self.power(sample) } else { Default::default() };
        let EstimatorState { noise, power_steps, powers, block, uncovered, .. } = &mut self.memory;
        let uncovered = uncovered.get_or_insert(false);
        *uncovered |= sample.uncovered;
        powers.doubt = powers.doubt.plus(doubt);
        let lasting =
            if powers.unrecorded { power_steps.lasting_as_in_0_1() } else { powers.history.restless() };
        if power == Power::Step && !lasting {
            noise.interrupt(); // a step is not noise
            powers.noise.interrupt();
        } else if good {
            let [a, b, c, d, e, f] = sample.spots;
            let [p, q, r] = sample.powers;
            noise.push([a, b, c, d, e, f, p, q, r]);
            if !powers.unrecorded {
                powers.noise.push(sample.powers);
            }
        }
        let mut mean = block.push(sample, power, self.settings.average)?;
        mean.sample.uncovered = std::mem::take(uncovered);
        let doubt = std::mem::take(&mut powers.doubt).mean(mean.count);
        Some(self.report(&mean, &doubt, steering))
    }

    /// State of the total power of a sample, judged by the configured standard uncertainty, or by the live
    /// one where that is larger.
    fn power(&mut self, sample: &Sample) -> (Power, Doubt) {
        let as_in_0_1 = self.memory.powers.unrecorded;
        if !self.exposure.to_steps() && !as_in_0_1 {
            return (Power::Steady, Doubt::default());
        }
        let configured = self.settings.power_noise;
        let each = (0..).zip(sample.powers).map(|(i, power)| self.power_noise(i, configured * power));
        let sigma = each.map(|sigma| sigma * sigma).sum::<f64>().sqrt();
        let EstimatorState { power_steps, powers, .. } = &mut self.memory;
        let total = sample.powers.iter().sum();
        if as_in_0_1 {
            return (power_steps.push_as_in_0_1(total, sigma), Doubt::default());
        }
        power_steps.push(total, sigma, &mut powers.history)
    }

    /// Standard uncertainty of a power: the configured one, or the live one where that is larger. Motion and the
    /// flicker of the laser do not raise it.
    fn power_noise(&self, psd: usize, configured: f64) -> f64 {
        let EstimatorState { noise, powers, .. } = &self.memory;
        noise.bounded(6 + psd, configured, |window, count, own| {
            let bounds = powers.noise.bounds(psd, window, count);
            bounds.map_or(own, |[by_total, by_fraction]| {
                own.min(by_fraction).min(by_total + self.exposure.variance(psd, own))
            })
        })
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
            uncovered: false,
        };
        let mean = Mean { sample: nothing, count: 0, gap: false, power: Power::Steady };
        let mut report = self.blank(&mean, &steering.without_observation());
        report.status |= Status::SOURCE_DOWN;
        report
    }

    fn report(&mut self, mean: &Mean, doubt: &Doubt, steering: &LoopState) -> PoseReport {
        let mut report = self.blank(mean, steering);
        let mut noise = self.stated_noise(mean);
        if light::judge(&self.settings, mean, &noise, &mut report.status) {
            report.lock = report.lock.without_observation();
            report.status.set(Status::NOT_LOCKED, true);
            return report;
        }
        if mean.gap {
            return report;
        }
        self.exposure.widen(&mut noise, &mean.sample, doubt);
        let signals = Signals { spots: mean.sample.spots, powers: mean.sample.powers };
        let solved = self.settings.estimator.solve(&signals, self.memory.warm.as_ref());
        if let Err(error) = solved.and_then(|solution| self.solved(solution, mean, &noise, &mut report)) {
            self.memory.warm = None;
            report.iterations = error.iterations();
            report.status |= light::reason(&error);
        }
        if let (Some(by_pose), Some(sensor)) = (&self.settings.by_pose, &report.pose) {
            by_pose.refresh(&mut self.memory.by_pose, sensor, &self.settings.frames, &report.spots);
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
        status.set(Status::OUT_OF_CALIBRATION, sample.uncovered);
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
            systematic: None,
            offset: None,
            steering_residual: None,
            mean_residual: None,
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
        let power = |i: usize| self.power_noise(i, power_noise * mean.sample.powers[i].abs());
        Noise {
            spots: std::array::from_fn(|i| self.memory.noise.sigma(i, spot_noise) / quieter),
            powers: std::array::from_fn(|i| power(i) / quieter),
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
        let Settings { estimator, readback, fuse, rate_hz, average, .. } = &self.settings;
        let Some(beam_position) = mean.sample.steering.map(|stage| readback.beam_position(stage)) else {
            return;
        };
        let Some(innovation) = Innovation::new(estimator.optics(), solution, spread, &beam_position) else {
            return;
        };
        report.steering_residual = Some(innovation.residual.norm());
        let EstimatorState { integrity, slow, .. } = &mut self.memory;
        let fusible = integrity.judge(&innovation);
        let slow = slow.get_or_insert_default();
        report.mean_residual = slow.push(&innovation, SlowResidual::window(rate_hz / f64::from(*average)));
        report.status.set(Status::INCONSISTENT, integrity.inconsistent() || slow.contradicts());
        let calm = mean.power == Power::Steady || mean.count >= DILUTED;
        if *fuse && fusible && calm {
            let fused = innovation.fuse(solution);
            report.pose = Some(fused.pose);
            report.covariance = Some(fused.spread.pose_covariance());
            report.offset = Some(fused.offset.into());
        }
    }
}
