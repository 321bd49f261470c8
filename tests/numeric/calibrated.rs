//! The stated uncertainty of a calibrated twin with a head of its own, against its true poses: points of a stage, fit,
//! configuration with tables and record, then channel map and estimation as in the daemon.

use trifacet::calibration::{edits, nominal, table};
use trifacet::config::{
    CalibrationContext, CalibrationState, Config, SharedSpread, Standing, Tables, TransformConfig,
    TwinTolerances, edit, parse,
};
use trifacet::core::centering::LoopState;
use trifacet::core::estimation::PoseReport;
use trifacet::core::pipeline::Measurement;
use trifacet::core::signals::Scan;
use trifacet::core::time::Mono;
use trifacet::optics::calibration::fit::{FIRST_FIELD, Job, fields, fit};
use trifacet::optics::calibration::map::Field;
use trifacet::optics::calibration::parameters::Tolerances;
use trifacet::optics::calibration::point::{Known, Point};
use trifacet::optics::calibration::result::{Calibration, Raw};
use trifacet::optics::{Pose, Rigid};
use trifacet::twin::Twin;
use trifacet::wire::Status;

use nalgebra::{Matrix6, Vector6};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

/// Means of 100 readings with 1.08 um, micrometres.
const SPOT_UM: f64 = 0.108;
/// Means of 100 readings with 1e-3.
const POWER: f64 = 1e-4;
/// The reference of the calibration: metres, radians.
const REFERENCE: [f64; 2] = [0.1e-6, 0.5e-6];
const BASE: &str = "[channels]\nreadback_um_per_v = 50.0\n";
/// Noise of the poses that are judged, micrometres: far less than what the calibration leaves unknown.
const QUIET_UM: f64 = 0.005;

/// A calibrated twin.
struct Calibrated {
    calibration: Calibration,
    context: CalibrationContext,
    twin: Config,
}

/// The twin of a head as rough as that of `config/real-head.toml`, with this noise.
fn rough(seed: u64, spot_um: f64, power: f64) -> Config {
    let rough = trifacet::config::load(Some("config/real-head.toml".as_ref())).unwrap();
    let mut config = Config::default();
    config.twin.tolerances = Some(TwinTolerances { seed, ..rough.twin.tolerances.unwrap() });
    (config.twin.spot_noise_um, config.twin.power_noise, config.twin.converter_bits) = (spot_um, power, 24);
    config
}

/// A scan of the twin with the mirror at a pose of its stage, and the beam on the apex.
fn scan(config: &Config, pose: &Pose, noise: u64) -> (Twin, Scan) {
    let mut config = config.clone();
    config.twin.seed = noise;
    let mut aside = [0.0; 2];
    for _ in 0..2 {
        config.twin.laser_offset_um = aside;
        let mut twin = Twin::new(&config).unwrap();
        twin.place(*pose);
        let offset = twin.next_scan().truth.offset * 1e6;
        aside = [aside[0] - offset.x, aside[1] - offset.y];
    }
    config.twin.laser_offset_um = aside;
    let mut twin = Twin::new(&config).unwrap();
    twin.place(*pose);
    let scan = twin.next_scan().arrived(Mono(0), 0).unwrap();
    (twin, scan)
}

fn poses(count: usize, scale: f64, seed: u64) -> Vec<Pose> {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut draw = || {
        Pose::from_array(std::array::from_fn(|i| {
            // Dense towards the limits, as a plan of a calibration.
            let along = (std::f64::consts::PI * (rng.random::<f64>() - 0.5)).sin();
            along * scale * if i < 3 { 1e-3 } else { 5e-3 }
        }))
    };
    (0..count).map(|_| draw()).collect()
}

/// Readings of the twin at poses of its stage, as the points of a calibration.
fn points(seed: u64, count: usize) -> Vec<Point> {
    let twin = rough(seed, SPOT_UM, POWER);
    let channels = parse(BASE, None).unwrap().read_channels().unwrap();
    let mut rng = Pcg64::seed_from_u64(seed + 1000);
    let mut noise = |sigma: f64| sigma * rng.sample::<f64, _>(StandardNormal);
    let mut point = |(k, pose): (usize, &Pose)| {
        let (source, scan) = scan(&twin, pose, 10_000 * seed + k as u64);
        let sample = channels.map(source.identity()).unwrap().sample(&scan);
        let values = pose.to_array();
        Point {
            spots: sample.spots,
            spot_deviations: [SPOT_UM * 1e-6; 6],
            powers: sample.powers,
            power_deviations: sample.powers.map(|power| power * POWER),
            reference: std::array::from_fn(|i| {
                let deviation = REFERENCE[i / 3];
                Some(Known { value: values[i] + noise(deviation), deviation })
            }),
            steering: None,
            run: None,
        }
    };
    poses(count, 1.1, seed).iter().enumerate().map(&mut point).collect()
}

/// The twin, calibrated by these points.
fn calibrated(seed: u64, points: &[Point], fields: &[Field]) -> Calibrated {
    let config = parse(BASE, None).unwrap();
    let (nominal, tolerances) = (nominal(&config).unwrap(), Tolerances::default());
    let fitted = fit(Job { nominal: &nominal, tolerances: &tolerances, points, fields }, |_| ()).unwrap();
    println!("head {seed}: {:.3} per row, {:?}", fitted.cost_per_row(), fitted.calibration.field);
    let calibration = fitted.calibration;
    let mut config = parse(&edit::edited(BASE, &edits(&calibration, &config)).unwrap(), None).unwrap();
    config.twin.converter_bits = 24; // as that of the twin
    config.estimation.spot_noise_um = QUIET_UM;
    config.estimation.power_noise = 1e-6;
    config.uncertainty.tare_readings = 1;
    config.uncertainty.beam_offset_um = Some(0.05);
    let tables = Tables([0, 1, 2].map(|psd| Some(table(&calibration, psd, "today").into_bytes())));
    let spread = SharedSpread(calibration.spread([1e-3, 5e-3]).unwrap().into());
    let spread = SharedSpread::from_bytes(&spread.to_bytes());
    let state = CalibrationState { record: None, standing: Standing::Valid, spread };
    let context = CalibrationContext { config, tables, calibration: state };
    Calibrated { calibration, context, twin: rough(seed, QUIET_UM, 1e-6) }
}

/// A judged pose.
struct Judged {
    /// Published less true pose.
    error: Vector6<f64>,
    /// Before correction tables and gains.
    raw: Raw,
    report: PoseReport,
}

impl Calibrated {
    fn measurement(&self) -> Measurement {
        self.context.config.measurement(&self.context).unwrap()
    }

    /// A sample of the mirror at a pose of its stage, and its report.
    fn measured(&self, with: &mut Measurement, pose: &Pose, noise: u64) -> (Raw, PoseReport) {
        let (source, scan) = scan(&self.twin, pose, noise);
        with.source(source.identity().clone().into()).unwrap();
        let raw = parse("", None).unwrap().read_channels().unwrap();
        let raw = raw.map(source.identity()).unwrap().sample(&scan);
        let sample = with.mapping.sample(&scan).unwrap();
        let report = with.sample(&sample, &LoopState::default()).unwrap();
        (Raw { spots: raw.spots, powers: raw.powers }, report)
    }

    /// Tares at a pose of the stage. `None` if the mirror cannot be measured there.
    fn tare(&mut self, stage: &Pose) -> Option<Raw> {
        self.context.config.frames.tare = TransformConfig::default();
        let (raw, report) = self.measured(&mut self.measurement(), stage, 77);
        self.context.config.frames.tare = TransformConfig::of(&report.pose?);
        (!report.status.has(Status::OUT_OF_CALIBRATION)).then_some(raw)
    }

    /// Fresh poses relative to a tare at a pose of the stage. Those that are off a PSD of this head, or say that they are
    /// not covered, do not count.
    fn judged(&mut self, tare: &Pose, count: usize, seed: u64) -> Option<(Raw, Vec<Judged>)> {
        let zero = self.tare(tare)?;
        let mut measurement = self.measurement();
        let mut one = |(k, pose): (usize, &Pose)| {
            let (raw, report) = self.measured(&mut measurement, pose, 500_000 + k as u64);
            if report.status.has(Status::OUT_OF_CALIBRATION) {
                return None;
            }
            let truth = Pose::from(&(Rigid::from(tare).inverse() * Rigid::from(pose)));
            let error = Vector6::from(report.pose?.to_array()) - Vector6::from(truth.to_array());
            Some(Judged { error, raw, report })
        };
        let judged = poses(count, 1.0, seed).iter().enumerate().filter_map(&mut one).collect();
        Some((zero, judged))
    }
}

/// Normalised error squared: 6 in the mean for a true covariance.
fn nees(error: &Vector6<f64>, covariance: &Matrix6<f64>) -> f64 {
    error.dot(&(covariance.cholesky().unwrap().inverse() * error))
}

/// The errors of a head at several tares.
#[derive(Debug, Default)]
struct Summary {
    count: f64,
    /// Sum of the normalised errors squared.
    nees: f64,
    /// Sums of squares of errors: m, rad.
    squares: [f64; 2],
}

impl Summary {
    fn add(&mut self, judged: &[Judged]) {
        for Judged { error, report, .. } in judged {
            self.count += 1.0;
            self.nees += nees(error, &report.covariance.unwrap());
            for i in 0..6 {
                self.squares[i / 3] += error[i].powi(2) / 3.0;
            }
        }
    }

    fn mean(&self) -> f64 {
        self.nees / self.count
    }

    /// In micrometres and microradians.
    fn rms(&self) -> [f64; 2] {
        self.squares.map(|sum| (sum / self.count).sqrt() * 1e6)
    }
}

#[test]
fn a_calibrated_twin_states_what_its_errors_are_and_as_its_calibration_does() {
    let mut made = calibrated(7, &points(7, 150), &[FIRST_FIELD]);
    let mut all = Summary::default();
    for (seed, tare) in (0..).zip([Pose::default(), Pose::from_array([2e-4, -1e-4, 1e-4, 5e-4, -1e-3, 8e-4])])
    {
        let (zero, judged) = made.judged(&tare, 20, 99 + seed).unwrap();
        all.add(&judged);
        let raws: Vec<Raw> = judged.iter().map(|judged| judged.raw).collect();
        let exact = made.calibration.relative_covariances(&raws, &zero).unwrap();
        for (Judged { report, .. }, exact) in judged.iter().zip(exact) {
            let (systematic, exact) = (report.systematic.unwrap(), exact.unwrap());
            for i in 0..6 {
                let ratio = (systematic[(i, i)] / exact[(i, i)]).sqrt();
                assert!((0.95..1.05).contains(&ratio), "{i}: {ratio}");
            }
        }
    }
    println!("mean of {:.2}, rms {:.3?}", all.mean(), all.rms());
    assert!(all.count > 25.0, "{all:?}");
    // With so few points the map is known to a few tenths of a micrometre; the errors of one head are common to its poses.
    assert!(all.rms()[0] < 1.0 && all.rms()[1] < 2.5, "{:?}", all.rms());
    assert!((1.0..12.0).contains(&all.mean()), "{}", all.mean());
}

/// `cargo test --release --test numeric calibrated:: -- --ignored --nocapture`
///
/// Six would be the mean for errors as the prior of the maps expects them (the test in the optics crate). The ripple of
/// the twin has no waves below 2 mm, that of the prior has: docs/uncertainty.md.
#[test]
#[ignore = "takes ten minutes"]
fn the_errors_of_ten_calibrated_heads_are_as_large_as_stated_or_somewhat_smaller() {
    let one = |seed: u64| {
        let mut made = calibrated(seed, &points(seed, 500), &fields());
        let mut all = Summary::default();
        // The error of a tare is common to all poses relative to it: several tares, for the scatter of one head to be less.
        for (k, tare) in (0..).zip(poses(12, 0.7, seed + 300)) {
            if let Some((_, judged)) = made.judged(&tare, 25, 1000 * seed + k) {
                all.add(&judged);
            }
        }
        println!("head {seed}: mean of {:.2}, rms {:.3?}", all.mean(), all.rms());
        all.mean()
    };
    let each: Vec<f64> = (1..=10).map(one).collect();
    let mean = each.iter().sum::<f64>() / 10.0;
    let deviation = (each.iter().map(|nees| (nees - mean).powi(2)).sum::<f64>() / 90.0).sqrt();
    println!("normalised error squared, mean of ten heads: {mean:.2} +- {deviation:.2}");
    assert!((4.2..6.3).contains(&mean), "{mean} +- {deviation}: {each:?}");
}
