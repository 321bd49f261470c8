//! Samples to reports. Pure: told the time and the state of the loop.

use nalgebra::Matrix6;

use super::block::{Block, Mean};
use super::noise::LiveNoise;
use super::{Frames, PoseReport, Status};
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
    frames: Frames,
    config: u32,
}

impl Settings {
    /// From a checked configuration; `calibrated` if every PSD has a correction table; `id` is the
    /// configuration's fingerprint.
    pub fn new(config: &Config, calibrated: bool, id: u32) -> Result<Self, HeadError> {
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
            frames: Frames::new(&config.frames),
            config: id,
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

    /// From the next sample on, all is to be done with other settings: the samples before and after make
    /// no common mean.
    pub fn retune(&mut self, settings: Settings) {
        self.settings = settings;
        self.block.clear();
        self.noise.interrupt();
        self.warm = None;
    }

    /// A report as it is published: in the user's frame.
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
        // A command is no news of the stage any more: its lease runs out, and the board acts by itself.
        report.steering = None;
        report
    }

    fn report(&mut self, mean: &Mean, steering: &LoopState) -> PoseReport {
        let mut report = self.blank(mean, steering);
        let noise = self.stated_noise(mean);
        if self.light(mean, &noise, &mut report.status) {
            report.lock = report.lock.unseen();
            report.status.set(Status::NOT_LOCKED, true);
            return report;
        }
        if mean.gap {
            return report;
        }
        let signals = Signals { spots: mean.sample.spots, powers: mean.sample.powers };
        let solved = self.settings.estimator.solve(&signals, self.warm.as_ref());
        if let Err(error) = solved.and_then(|solution| self.solved(solution, mean, &noise, &mut report)) {
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
            steering: sample.steering.or(steering.position),
        }
    }

    /// Notes what the light is like; true if no pose can come of it.
    fn light(&self, mean: &Mean, noise: &Noise, status: &mut Status) -> bool {
        let sample = &mean.sample;
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

    fn solved(
        &mut self,
        solution: Solution,
        mean: &Mean,
        noise: &Noise,
        report: &mut PoseReport,
    ) -> Result<(), SolveError> {
        let estimator = &self.settings.estimator;
        let covariance: Matrix6<f64> = estimator.sensitivity(&solution)?.pose_covariance(noise);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Pose, Vec2};
    use crate::publishing::stamp::tests::report;

    fn estimation(text: &str, id: u32) -> Estimation {
        let config = crate::config::parse(text, None).unwrap();
        Estimation::new(Settings::new(&config, true, id).unwrap())
    }

    /// The light of the mirror at rest.
    fn sample(index: u64) -> Sample {
        let optics = Optics::new(&Config::default().head.build().unwrap());
        let light = optics.trace(Model::Gaussian, &Pose::default(), Vec2::zeros()).unwrap();
        Sample {
            index,
            time: Mono(index as i64 * 1_000_000),
            time_sigma_ns: None,
            lost: 0,
            spots: light.spots,
            powers: light.powers.map(|fraction| fraction * 1e-3),
            psds: [PsdState::Good; 3],
            steering: None,
            output_railed: false,
        }
    }

    #[test]
    fn only_the_pose_goes_to_the_users_frame() {
        let estimation = estimation("frames.tool.translation_mm = [0, 0, -40]", 5);
        let sensor = report();
        let user = estimation.in_user_frame(&sensor);
        let pose = user.pose.unwrap();
        assert!((pose.t.z + 0.04).abs() < 1e-5, "{pose:?}");
        // 40 mm below, a pitch of -5 urad is 0.2 um along x.
        assert!((pose.t.x - 1e-6 - 0.2e-6).abs() < 1e-11, "{pose:?}");
        let sd = user.covariance.unwrap()[(0, 0)].sqrt();
        assert!((sd - 2e-6 * 1.0016_f64.sqrt()).abs() < 1e-12, "{sd}");
        assert_eq!(PoseReport { pose: sensor.pose, covariance: sensor.covariance, ..user }, sensor);
    }

    #[test]
    fn a_pose_that_has_no_angles_there_has_a_reason_instead() {
        let estimation = estimation("frames.base.rotation_deg = [0, 90, 0]", 5);
        let user = estimation.in_user_frame(&report());
        assert_eq!((user.pose, user.covariance), (None, None));
        assert!(user.status.has(Status::OUT_OF_RANGE) && !user.status.has(Status::POSE_VALID));
        let dark = PoseReport { pose: None, covariance: None, status: Status::PSD_A_LOW, ..report() };
        assert_eq!(estimation.in_user_frame(&dark), dark);
    }

    #[test]
    fn a_block_has_samples_of_one_meaning_only() {
        let mut estimation = estimation("estimation.average = 4", 5);
        let steering = LoopState::default();
        let mut reports = Vec::new();
        for index in 0..12 {
            if index == 6 {
                let other = crate::config::parse("estimation.average = 4", None).unwrap();
                estimation.retune(Settings::new(&other, true, 6).unwrap());
            }
            reports.extend(estimation.sample(&sample(index), &steering));
        }
        let seen: Vec<_> = reports.iter().map(|r| (r.config, r.index, r.pose.is_some())).collect();
        assert_eq!(seen, [(5, 3, true), (6, 9, true)]);
    }
}
