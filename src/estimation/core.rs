//! Samples to reports. Pure: told the time and the state of the loop.

use nalgebra::Matrix6;

use super::block::{Block, Mean};
use super::noise::LiveNoise;
use super::{PoseReport, Status};
use crate::acquisition::{PsdState, Sample};
use crate::centering::{LockState, LoopState};
use crate::clock::Mono;
use crate::config::Config;
use crate::optics::{Estimator, HeadError, Model, Noise, Optics, Signals, Solution, SolveError, Vec3};

/// A power below so many of its deviations is no light to reckon with.
const LIGHT: f64 = 5.0;

const LOW: [Status; 3] = [Status::PSD_A_LOW, Status::PSD_B_LOW, Status::PSD_C_LOW];
const CLIPPED: [Status; 3] = [Status::PSD_A_CLIPPED, Status::PSD_B_CLIPPED, Status::PSD_C_CLIPPED];
const EDGE: [Status; 3] = [Status::PSD_A_EDGE, Status::PSD_B_EDGE, Status::PSD_C_EDGE];

/// What estimation needs to know.
#[derive(Clone, Debug)]
pub struct Settings {
    estimator: Estimator,
    average: u16,
    spot_noise: f64,
    power_noise: f64,
    edge_margin: f64,
    balance_limit: f64,
    /// Bits that are always set.
    fixed: Status,
}

impl Settings {
    /// From a checked configuration; `calibrated` if every PSD has a correction table.
    pub fn new(config: &Config, calibrated: bool) -> Result<Self, HeadError> {
        let estimation = &config.estimation;
        let mut fixed = Status::default();
        fixed.set(Status::UNCALIBRATED, !calibrated);
        Ok(Self {
            estimator: Estimator::new(Optics::new(&config.head.build()?), estimation.model.into()),
            average: estimation.average,
            spot_noise: estimation.spot_noise_um * 1e-6,
            power_noise: estimation.power_noise,
            edge_margin: estimation.edge_margin_mm * 1e-3,
            balance_limit: estimation.balance_limit,
            fixed,
        })
    }
}

/// Turns samples into reports.
#[derive(Clone, Debug)]
pub struct Estimation {
    settings: Settings,
    noise: LiveNoise,
    block: Block,
    warm: Option<Solution>,
    /// The computed light of a twin, rather than measured light.
    simulated: bool,
    index: u64,
}

impl Estimation {
    /// An estimation that has seen nothing yet.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            noise: LiveNoise::default(),
            block: Block::default(),
            warm: None,
            simulated: false,
            index: 0,
        }
    }

    /// A source is up.
    pub fn source(&mut self, simulated: bool) {
        self.simulated = simulated;
        self.block.clear();
        self.noise.interrupt();
    }

    /// Takes a sample; gives a report at the end of each block. The caller stamps it with the time at
    /// which it was solved.
    pub fn sample(&mut self, sample: &Sample, steering: &LoopState) -> Option<PoseReport> {
        self.index = sample.index;
        let good = sample.psds.iter().all(|psd| *psd == PsdState::Good);
        if sample.lost > 0 || !good {
            self.noise.interrupt();
        }
        if good {
            let [a, b, c, d, e, f] = sample.spots;
            let [p, q, r] = sample.powers;
            self.noise.push([a, b, c, d, e, f, p, q, r]);
        }
        let mean = self.block.push(sample, self.settings.average)?;
        Some(self.report(&mean, steering))
    }

    /// What there is to say while no samples come.
    pub fn silence(&mut self, now: Mono, steering: &LoopState) -> PoseReport {
        self.block.clear();
        self.noise.interrupt();
        let nothing = Sample {
            index: self.index,
            time: now,
            time_sigma_ns: None,
            lost: 0,
            spots: [f64::NAN; 6],
            powers: [f64::NAN; 3],
            psds: [PsdState::Good; 3],
            steering: None,
            output_railed: false,
        };
        let steering = LoopState { lock: steering.lock.unseen(), ..*steering };
        let mut report = self.blank(&Mean { sample: nothing, count: 0, gap: false }, &steering);
        report.status |= Status::SOURCE_DOWN;
        report
    }

    fn report(&mut self, mean: &Mean, steering: &LoopState) -> PoseReport {
        let mut report = self.blank(mean, steering);
        if self.light(mean, &mut report.status) {
            report.lock = report.lock.unseen();
            report.status.set(Status::NOT_LOCKED, true);
            return report;
        }
        if mean.gap {
            return report;
        }
        let signals = Signals { spots: mean.sample.spots, powers: mean.sample.powers };
        let solved = self.settings.estimator.solve(&signals, self.warm.as_ref());
        if let Err(error) = solved.and_then(|solution| self.solved(solution, mean, &mut report)) {
            self.warm = None;
            report.iterations = error.iterations();
            report.status |= reason(&error);
        }
        report
    }

    /// A report without a pose.
    fn blank(&self, mean: &Mean, steering: &LoopState) -> PoseReport {
        let sample = &mean.sample;
        let railed = sample.output_railed || steering.lock == LockState::Railed;
        let mut status = self.settings.fixed;
        status.set(Status::SIMULATED, self.simulated);
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
            steering: sample.steering.or(steering.position),
        }
    }

    /// Notes what the light is like; true if no pose can come of it.
    fn light(&self, mean: &Mean, status: &mut Status) -> bool {
        let sample = &mean.sample;
        let noise = self.stated_noise(mean);
        let mut fatal = false;
        for i in 0..3 {
            let clipped = sample.psds[i] == PsdState::Clipped;
            let faint = sample.powers[i] < LIGHT * noise.powers[i];
            let low = sample.psds[i] == PsdState::Low || (!clipped && faint);
            status.set(CLIPPED[i], clipped);
            status.set(LOW[i], low);
            let edge = self.settings.estimator.optics().half_sizes()[i] - self.settings.edge_margin;
            let spot = &sample.spots[2 * i..2 * i + 2];
            status.set(EDGE[i], spot.iter().any(|s| s.abs() > edge)); // not if it is NaN
            fatal |= clipped || low;
        }
        let total: f64 = sample.powers.iter().sum();
        let balanced = |p: &f64| (p / total - 1.0 / 3.0).abs() <= self.settings.balance_limit && total > 0.0;
        status.set(Status::UNBALANCED, !sample.powers.iter().all(balanced));
        fatal
    }

    /// The deviations of the signals of a block: configured, or live where that is larger.
    fn stated_noise(&self, mean: &Mean) -> Noise {
        let quieter = f64::from(mean.count.max(1)).sqrt();
        let Settings { spot_noise, power_noise, .. } = self.settings;
        let live = |signal, configured| self.noise.deviation(signal, configured) / quieter;
        Noise {
            spots: std::array::from_fn(|i| live(i, spot_noise)),
            powers: std::array::from_fn(|i| live(6 + i, power_noise * mean.sample.powers[i].abs())),
        }
    }

    fn solved(&mut self, solution: Solution, mean: &Mean, report: &mut PoseReport) -> Result<(), SolveError> {
        let estimator = &self.settings.estimator;
        let noise = self.stated_noise(mean);
        let covariance: Matrix6<f64> = estimator.sensitivity(&solution)?.pose_covariance(&noise);
        report.status |= Status::POSE_VALID;
        report.pose = Some(solution.pose);
        report.covariance = Some(covariance);
        report.iterations = solution.iterations;
        if estimator.model() == Model::Gaussian {
            report.offset = Some(solution.offset.into());
            report.steering_residual = mean.sample.steering.map(|[x, y]| {
                let t = solution.pose.t;
                let apex = estimator.optics().across(Vec3::new(t.x - x, t.y - y, t.z));
                (apex + solution.offset).norm()
            });
        }
        self.warm = Some(solution);
        Ok(())
    }
}

/// The status bit for a refusal of the solver.
fn reason(error: &SolveError) -> Status {
    match error {
        SolveError::OffPsd { .. } | SolveError::OutOfRange { .. } => Status::OUT_OF_RANGE,
        SolveError::Dark { psd: 'A', .. } => LOW[0],
        SolveError::Dark { psd: 'B', .. } => LOW[1],
        SolveError::Dark { .. } => LOW[2],
        SolveError::NotFinite { .. } | SolveError::Singular { .. } | SolveError::NotConverged { .. } => {
            Status::NOT_CONVERGED
        }
    }
}
