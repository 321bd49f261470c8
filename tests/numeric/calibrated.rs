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
use trifacet::optics::Pose;
use trifacet::optics::calibration::fit::{FIRST_FIELD, Job, fields, fit};
use trifacet::optics::calibration::map::Field;
use trifacet::optics::calibration::parameters::Tolerances;
use trifacet::optics::calibration::point::{Known, Point};
use trifacet::optics::calibration::result::{Calibration, Raw};
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

fn calibrated(seed: u64, count: usize, fields: &[Field]) -> Calibrated {
    let twin = rough(seed, SPOT_UM, POWER);
    let base = "[channels]\nreadback_um_per_v = 50.0\n";
    let config = parse(base, None).unwrap();
    let channels = config.read_channels().unwrap();
    let mut rng = Pcg64::seed_from_u64(seed + 1000);
    let mut noise = |sigma: f64| sigma * rng.sample::<f64, _>(StandardNormal);
    let points: Vec<Point> = poses(count, 1.1, seed)
        .iter()
        .enumerate()
        .map(|(k, pose)| {
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
        })
        .collect();
    let (nominal, tolerances) = (nominal(&config).unwrap(), Tolerances::default());
    let job = Job { nominal: &nominal, tolerances: &tolerances, points: &points, fields };
    let fitted = fit(job, |_| ()).unwrap();
    println!("head {seed}: {:.3} per row, {:?}", fitted.cost_per_row(), fitted.calibration.field);
    let calibration = fitted.calibration;
    let mut config = parse(&edit::edited(base, &edits(&calibration, &config)).unwrap(), None).unwrap();
    config.estimation.spot_noise_um = QUIET_UM;
    config.estimation.power_noise = 1e-6;
    config.uncertainty.tare_readings = 1;
    config.uncertainty.beam_offset_um = Some(0.05);
    let tables = Tables([0, 1, 2].map(|psd| Some(table(&calibration, psd, "today").into_bytes())));
    let spread = SharedSpread(calibration.spread().unwrap().into());
    let spread = SharedSpread::from_bytes(&spread.to_bytes());
    let state = CalibrationState { record: None, standing: Standing::Valid, spread };
    let mut made = Calibrated {
        calibration,
        context: CalibrationContext { config, tables, calibration: state },
        twin: rough(seed, QUIET_UM, 1e-6),
    };
    made.tare();
    made
}

impl Calibrated {
    fn measurement(&self) -> Measurement {
        self.context.config.measurement(&self.context).unwrap()
    }

    /// A sample of the mirror at a pose of its stage, and its report.
    fn measured(&self, with: &mut Measurement, pose: &Pose, noise: u64) -> (Raw, PoseReport) {
        let (source, scan) = scan(&self.twin, pose, noise);
        with.source(source.identity().clone().into()).unwrap();
        let raw = trifacet::config::parse("", None).unwrap().read_channels().unwrap();
        let raw = raw.map(source.identity()).unwrap().sample(&scan);
        let sample = with.mapping.sample(&scan).unwrap();
        let report = with.sample(&sample, &LoopState::default()).unwrap();
        (Raw { spots: raw.spots, powers: raw.powers }, report)
    }

    /// Tares with the stage at its zero.
    fn tare(&mut self) {
        let (_, report) = self.measured(&mut self.measurement(), &Pose::default(), 77);
        let pose = report.pose.unwrap();
        let degrees = [pose.roll, pose.pitch, pose.yaw].map(f64::to_degrees);
        self.context.config.frames.tare =
            TransformConfig { translation_mm: (pose.t * 1e3).into(), rotation_deg: degrees };
    }

    /// For fresh poses: errors, readings, and reports.
    fn judged(&self, count: usize) -> Vec<(Vector6<f64>, Raw, PoseReport)> {
        let mut measurement = self.measurement();
        let mut one = |(k, pose): (usize, &Pose)| {
            let (raw, report) = self.measured(&mut measurement, pose, 500_000 + k as u64);
            if report.status.has(Status::OUT_OF_CALIBRATION) {
                return None;
            }
            let error = Vector6::from(report.pose?.to_array()) - Vector6::from(pose.to_array());
            Some((error, raw, report))
        };
        let judged: Vec<_> = poses(count, 1.0, 99).iter().enumerate().filter_map(&mut one).collect();
        // The others are off a PSD of this head, or say that they are not covered.
        assert!(judged.len() > count * 4 / 5, "{} of {count}", judged.len());
        judged
    }
}

/// Normalised error squared; and squares of errors in micrometres and microradians.
fn assess(errors: &[(Vector6<f64>, Raw, PoseReport)]) -> (f64, [f64; 2]) {
    let (mut nees, mut squares) = (0.0, [0.0; 2]);
    let count = errors.len() as f64;
    for (error, _, report) in errors {
        let inverse = report.covariance.unwrap().cholesky().unwrap().inverse();
        nees += error.dot(&(inverse * error)) / count;
        for i in 0..6 {
            squares[i / 3] += (error[i] * 1e6).powi(2) / (3.0 * count);
        }
    }
    (nees, squares)
}

#[test]
fn a_calibrated_twin_states_what_its_errors_are_and_as_its_calibration_does() {
    let made = calibrated(7, 150, &[FIRST_FIELD]);
    let judged = made.judged(30);
    let (nees, squares) = assess(&judged);
    println!("mean of {nees:.2}, rms {:.3?}", squares.map(f64::sqrt));
    // With so few points the map is known to a few tenths of a micrometre; the errors of one head are common to its poses.
    assert!(squares[0].sqrt() < 1.0 && squares[1].sqrt() < 2.5, "{squares:?}");
    assert!((1.0..16.0).contains(&nees), "{nees}");
    let (zero, _) = made.measured(&mut made.measurement(), &Pose::default(), 77);
    let raws: Vec<Raw> = judged.iter().map(|(_, raw, _)| *raw).collect();
    let exact = made.calibration.relative_covariances(&raws, &zero).unwrap();
    for ((_, _, report), exact) in judged.iter().zip(exact) {
        let (systematic, exact): (Matrix6<f64>, _) = (report.systematic.unwrap(), exact.unwrap());
        for i in 0..6 {
            let ratio = (systematic[(i, i)] / exact[(i, i)]).sqrt();
            assert!((0.95..1.07).contains(&ratio), "{i}: {ratio}");
        }
    }
}

/// `cargo test --release --test numeric calibrated:: -- --ignored --nocapture`
#[test]
#[ignore = "takes ten minutes"]
fn the_errors_of_ten_calibrated_heads_are_as_large_as_stated() {
    let each: Vec<f64> = (1..=10)
        .map(|seed| {
            let (nees, squares) = assess(&calibrated(seed, 500, &fields()).judged(200));
            println!("head {seed}: mean of {nees:.2}, rms {:.3?}", squares.map(f64::sqrt));
            nees
        })
        .collect();
    let mean = each.iter().sum::<f64>() / each.len() as f64;
    println!("normalised error squared, mean of ten heads: {mean:.2}");
    // All poses of a head have errors in common: the heads scatter, and so does the mean of ten of them.
    let variance = each.iter().map(|nees| (nees - mean).powi(2)).sum::<f64>() / 9.0;
    let sigma = (variance / 10.0).sqrt();
    println!("its standard deviation: {sigma:.2}");
    assert!((mean - 6.0).abs() < (3.0 * sigma).min(1.5), "{mean} +- {sigma}: {each:?}");
}
