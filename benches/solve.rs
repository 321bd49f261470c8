//! Compares the solvers with the `levenberg-marquardt` crate, in one run: `cargo bench --bench solve`.
//!
//! The crate solves the six-signal problem with the same ray model and the same analytic derivatives. Its
//! tolerances are 1e-6: with its defaults, about 1e-15, it takes 2.6 times as long, which would not be a
//! fair comparison. Warm: the solver starts from the solution of the previous sample, which differs by one
//! standard deviation of the noise. Cold: it starts from zero. Before the measurement, the results are
//! checked to agree within 1e-12 m and rad.
//!
//! Group "frame": samples of the twin to frames of 192 bytes, without and with the systematic part of the uncertainty
//! (a calibration and what `[uncertainty]` states). At rest only the noise moves the spots; the mirror that moves by
//! 1 mm with 1 Hz needs the systematic part anew some hundred times a second. Both take turns, and the shortest of their
//! times count: `cargo bench --bench solve -- frame`.

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{Matrix6, Owned, U6, Vector6};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::hint::black_box;
use trifacet::clock::SystemClock;
use trifacet::config::{CalibrationContext, CalibrationState, SharedSpread, Standing, Tables, parse};
use trifacet::core::centering::LoopState;
use trifacet::core::pipeline::Measurement;
use trifacet::core::signals::Sample;
use trifacet::core::stamp::Stamp;
use trifacet::core::time::{Clock as _, Mono};
use trifacet::twin::Twin;
use trifacet_optics::calibration::fit::{FIRST_FIELD, Job, fit};
use trifacet_optics::calibration::parameters::Tolerances;
use trifacet_optics::calibration::point::{Known, Point};
use trifacet_optics::ray::Ray;
use trifacet_optics::{Estimator, Head, Model, Optics, Pose, Psd, Signals, Solution, Vec2, Vec3};

const CASES: usize = 64;
/// Turns of the comparison of frames.
const ROUNDS: usize = 100;

/// The six-signal problem in the form that the crate requires.
#[derive(Clone)]
struct RayProblem<'a> {
    head: &'a Head,
    spots: [f64; 6],
    pose: Vector6<f64>,
    rays: [Ray; 3],
}

impl<'a> RayProblem<'a> {
    fn new(head: &'a Head, spots: [f64; 6], start: &Pose) -> Self {
        Self { head, spots, pose: Vector6::from(start.to_array()), rays: rays(head, start) }
    }

    fn pose(&self) -> Pose {
        Pose::from_array(self.pose.into())
    }
}

impl LeastSquaresProblem<f64, U6, U6> for RayProblem<'_> {
    type ParameterStorage = Owned<f64, U6>;
    type ResidualStorage = Owned<f64, U6>;
    type JacobianStorage = Owned<f64, U6, U6>;

    fn set_params(&mut self, pose: &Vector6<f64>) {
        self.pose = *pose;
        self.rays = rays(self.head, &self.pose());
    }

    fn params(&self) -> Vector6<f64> {
        self.pose
    }

    fn residuals(&self) -> Option<Vector6<f64>> {
        let mut residuals = Vector6::zeros();
        for (i, ray) in self.rays.iter().enumerate() {
            let spot = ray.spot;
            residuals[2 * i] = spot[0] - self.spots[2 * i];
            residuals[2 * i + 1] = spot[1] - self.spots[2 * i + 1];
        }
        Some(residuals)
    }

    fn jacobian(&self) -> Option<Matrix6<f64>> {
        let mut jacobian = Matrix6::zeros();
        let (sa, ca) = self.pose[5].sin_cos();
        let (sb, cb) = self.pose[4].sin_cos();
        let axes = [Vec3::new(ca * cb, sa * cb, -sb), Vec3::new(-sa, ca, 0.0), Vec3::z()];
        for (i, ray) in self.rays.iter().enumerate() {
            let psd: &Psd = &self.head.psds[i];
            for (row, axis) in [(2 * i, psd.y), (2 * i + 1, psd.z)] {
                let slopes = ray.row(psd, axis, Vec3::zeros());
                for k in 0..3 {
                    jacobian[(row, k)] = slopes.shift[k];
                    jacobian[(row, 3 + k)] = slopes.turn.dot(&axes[k]);
                }
            }
        }
        Some(jacobian)
    }
}

fn rays(head: &Head, pose: &Pose) -> [Ray; 3] {
    let rotation = pose.rotation();
    [0, 1, 2].map(|i| Ray::new(&head.psds[i], rotation * head.facets[i], pose.t))
}

/// A sample and the solution of the previous one.
struct Case {
    signals: Signals,
    warm: Solution,
}

fn main_head() -> Head {
    Head::nominal(0.25, 0.013, std::f64::consts::FRAC_PI_4, 0.46e-3).expect("the nominal head")
}

fn cases(estimator: &Estimator) -> Vec<Case> {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let mut draw = |scale: f64| random.random_range(-scale..scale);
    let mut cases = Vec::new();
    while cases.len() < CASES {
        let pose = Pose::from_array([3e-3, 3e-3, 3e-3, 6e-3, 6e-3, 12e-3].map(&mut draw));
        let offset = match estimator.model() {
            Model::Ray => Vec2::zeros(),
            Model::Gaussian => Vec2::new(draw(5e-5), draw(5e-5)),
        };
        let Ok(reading) = estimator.optics().trace(estimator.model(), &pose, offset) else { continue };
        let mut signals = Signals { spots: reading.spots, powers: reading.powers };
        let Ok(warm) = estimator.solve(&signals, None) else { continue };
        signals.spots.iter_mut().for_each(|spot| *spot += draw(1.08e-6 * 1.73));
        signals.powers.iter_mut().for_each(|power| *power *= 1.0 + draw(1.73e-3));
        cases.push(Case { signals, warm });
    }
    cases
}

fn crate_at_1e_6() -> LevenbergMarquardt<f64> {
    LevenbergMarquardt::new().with_tol(1e-6)
}

fn check_agreement(head: &Head, estimator: &Estimator, cases: &[Case]) {
    let mut worst: f64 = 0.0;
    for case in cases {
        for (start, warm) in [(case.warm.pose, Some(&case.warm)), (Pose::default(), None)] {
            let ours = estimator.solve(&case.signals, warm).expect("a solvable case");
            let problem = RayProblem::new(head, case.signals.spots, &start);
            let (theirs, report) = crate_at_1e_6().minimize(problem);
            assert!(report.termination.was_successful());
            let difference = Vector6::from(ours.pose.to_array()) - Vector6::from(theirs.pose().to_array());
            worst = worst.max(difference.amax());
        }
    }
    assert!(worst < 1e-12, "the solvers differ by {worst:e}");
    println!(
        "largest difference between the solvers: {worst:.1e} m or rad over {CASES} cases, warm and cold"
    );
}

fn solve(criterion: &mut Criterion) {
    let head = main_head();
    let ray = Estimator::new(Optics::new(&head), Model::Ray);
    let gaussian = Estimator::new(Optics::new(&head), Model::Gaussian);
    let six = cases(&ray);
    let nine = cases(&gaussian);
    check_agreement(&head, &ray, &six);

    for warm in [true, false] {
        let mut group = criterion.benchmark_group(if warm { "warm" } else { "cold" });
        group.throughput(criterion::Throughput::Elements(CASES as u64));
        group.bench_function("levenberg-marquardt crate, 6 signals, tol 1e-6", |b| {
            let starts = |case: &Case| if warm { case.warm.pose } else { Pose::default() };
            b.iter_batched_ref(
                || {
                    six.iter()
                        .map(|c| RayProblem::new(&head, c.signals.spots, &starts(c)))
                        .collect::<Vec<_>>()
                },
                |problems| {
                    for problem in problems.drain(..) {
                        black_box(crate_at_1e_6().minimize(problem));
                    }
                },
                BatchSize::SmallInput,
            );
        });
        for (name, estimator, cases) in
            [("ray, 6 signals", &ray, &six), ("gaussian, 9 signals", &gaussian, &nine)]
        {
            group.bench_function(name, |b| {
                b.iter(|| {
                    for case in cases {
                        let warm = warm.then_some(&case.warm);
                        let _ = black_box(estimator.solve(black_box(&case.signals), warm));
                    }
                });
            });
        }
    }
}

/// What a calibration with a stage leaves unknown of the default head.
fn spread() -> SharedSpread {
    let config = parse("", None).expect("the default configuration");
    let nominal = trifacet::calibration::nominal(&config).expect("the default head");
    let optics = Optics::new(&nominal.head);
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let mut draw = |scale: f64| random.random_range(-scale..scale);
    let mut points = Vec::new();
    while points.len() < 150 {
        let pose = [1.1e-3, 1.1e-3, 1.1e-3, 5.5e-3, 5.5e-3, 5.5e-3].map(&mut draw);
        let Ok(reading) = optics.trace(Model::Gaussian, &Pose::from_array(pose), Vec2::zeros()) else {
            continue;
        };
        points.push(Point {
            spots: reading.spots,
            spot_deviations: [0.1e-6; 6],
            powers: reading.powers,
            power_deviations: reading.powers.map(|power| 1e-4 * power),
            reference: std::array::from_fn(|i| {
                Some(Known { value: pose[i], deviation: if i < 3 { 0.1e-6 } else { 0.5e-6 } })
            }),
            steering: None,
            run: None,
        });
    }
    let tolerances = Tolerances::default();
    let job = Job { nominal: &nominal, tolerances: &tolerances, points: &points, fields: &[FIRST_FIELD] };
    let calibration = fit(job, |_| ()).expect("a fit").calibration;
    SharedSpread(calibration.spread([1e-3, 5e-3]).expect("a covariance").into())
}

const REST: &str = "twin.motion = []\n";
const MOVING: &str =
    "twin.motion = [{ axis = 'tz', kind = 'sine', amount_um = 1000.0, frequency_hz = 1.0 }]\n";
const STATED: &str =
    "[uncertainty]\ntemperature_range_k = 0.1\npointing_urad = 0.5\nreference_scale_ppm = 20\n";

/// Samples of the twin at 10 kHz, and what makes frames of them.
fn samples(text: &str, calibration: CalibrationState) -> (Vec<Sample>, Measurement) {
    let text = format!("acquisition.rate_hz = 10000\n{text}");
    let context = CalibrationContext {
        config: parse(&text, None).expect("a configuration"),
        tables: Tables::default(),
        calibration,
    };
    let mut twin = Twin::new(&context.config).expect("a twin");
    let mut measurement = context.config.measurement(&context).expect("a head");
    measurement.source(twin.identity().clone().into()).expect("all signals");
    let scans = (0..4096).map(|k| twin.next_scan().arrived(Mono(100_000 * k), 0).expect("a scan"));
    let samples = scans.map(|scan| measurement.mapping.sample(&scan).expect("a sample")).collect();
    (samples, measurement)
}

/// Seconds for a frame from each of these samples.
fn seconds(samples: &[Sample], measurement: &mut Measurement) -> f64 {
    let (state, stamp) = (LoopState::default(), Stamp::example());
    let start = SystemClock.now();
    for sample in samples {
        let report = measurement.sample(black_box(sample), &state).expect("a report");
        black_box(report.frame(stamp).encode());
    }
    SystemClock.now().seconds_since(start) / samples.len() as f64
}

fn frame(_: &mut Criterion) {
    let calibrated = CalibrationState { record: None, standing: Standing::Valid, spread: Some(spread()) };
    let uncertain = CalibrationState { standing: Standing::Valid, ..CalibrationState::default() };
    for (motion, mirror) in [(REST, "at rest"), (MOVING, "moving by 1 mm with 1 Hz")] {
        let (plain, mut without) = samples(motion, uncertain.clone());
        let (stated, mut with) = samples(&format!("{motion}{STATED}"), calibrated.clone());
        let mut least = [f64::INFINITY; 2];
        for _ in 0..ROUNDS {
            least[0] = least[0].min(seconds(&plain, &mut without));
            least[1] = least[1].min(seconds(&stated, &mut with));
        }
        let [without, with] = least.map(|s| s * 1e6);
        println!(
            "frame, mirror {mirror}: {without:.3} us without the systematic part, {with:.3} us with it: {:+.1} %",
            (with / without - 1.0) * 100.0
        );
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(50).measurement_time(std::time::Duration::from_secs(3));
    targets = solve, frame
}
criterion_main!(benches);
