//! A beam that a mirror tilts about a pivot: reference cases that an independent program computed from the law of
//! reflection, derivatives, and the uncertainty of the result.

#![allow(clippy::unwrap_used)]

use std::f64::consts::FRAC_PI_4;

use nalgebra::{SMatrix, SVector};
use trifacet_optics::covariance::sigmas;
use trifacet_optics::{
    BeamPosition, Ellipse, Estimator, Head, Innovation, Model, Noise, Optics, Pose, Signals, SolveError,
    Vec2, Vec3,
};

/// The reference files and their pivots, metres.
const REFERENCE: [(&str, [f64; 3]); 2] =
    [("tilt_z500.csv", [0.0, 0.0, 0.5]), ("tilt_z1000_aside.csv", [0.02, -0.01, 1.0])];

fn head() -> Head {
    Head::nominal(0.25, 0.013, FRAC_PI_4, 0.46e-3).unwrap()
}

fn optics(pivot: [f64; 3]) -> Optics {
    Optics::new(&head()).from_pivot(pivot.into()).unwrap()
}

fn rows(file: &str) -> Vec<Vec<f64>> {
    let path = format!("{}/../../tests/reference/{file}", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).unwrap();
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    assert_eq!(rows.len(), 64, "{file}");
    rows
}

fn pose(row: &[f64]) -> Pose {
    Pose::from_array(row[..6].try_into().unwrap())
}

fn signals(row: &[f64]) -> Signals {
    Signals { spots: row[8..14].try_into().unwrap(), powers: row[14..17].try_into().unwrap() }
}

/// Poses within the range of the sensor, with offsets of the beam.
fn states(optics: &Optics, count: usize) -> Vec<(Pose, Vec2, Signals)> {
    let mut random = 7_u64;
    let mut within = |limit: f64| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        limit * ((random >> 11) as f64 / (1_u64 << 52) as f64 - 1.0)
    };
    let mut states = Vec::new();
    for _ in 0..100 * count {
        let limits = [2e-3, 2e-3, 2e-3, 8e-3, 8e-3, 15e-3];
        let pose = Pose::from_array(limits.map(&mut within));
        let offset = Vec2::new(within(1e-4), within(1e-4));
        if let Ok(reading) = optics.trace(Model::Gaussian, &pose, offset) {
            states.push((pose, offset, Signals { spots: reading.spots, powers: reading.powers }));
        }
    }
    assert!(states.len() >= count);
    states.truncate(count);
    states
}

#[test]
fn the_traced_signals_are_those_of_the_reference() {
    for (file, pivot) in REFERENCE {
        let (mut spot, mut power): (f64, f64) = (0.0, 0.0);
        for row in rows(file) {
            let reading =
                optics(pivot).trace(Model::Gaussian, &pose(&row), Vec2::new(row[6], row[7])).unwrap();
            let expected = signals(&row);
            for (ours, theirs) in reading.spots.iter().zip(&expected.spots) {
                spot = spot.max((ours - theirs).abs());
            }
            for (ours, theirs) in reading.powers.iter().zip(&expected.powers) {
                power = power.max((ours - theirs).abs());
            }
        }
        println!("{file}: spots to {spot:.1e} m, powers to {power:.1e}");
        assert!(spot < 1e-11 && power < 1e-10, "{file}: {spot:e} {power:e}");
    }
}

#[test]
fn the_solver_finds_the_poses_of_the_reference() {
    for (file, pivot) in REFERENCE {
        let estimator = Estimator::new(optics(pivot), Model::Gaussian);
        let (mut worst, mut most): (f64, u8) = (0.0, 0);
        let mut last = None;
        for row in rows(file) {
            for warm in [None, last.as_ref()] {
                let solution = estimator.solve(&signals(&row), warm).unwrap();
                for (ours, theirs) in solution.pose.to_array().iter().zip(&row) {
                    worst = worst.max((ours - theirs).abs());
                }
                worst = worst.max((solution.offset - Vec2::new(row[6], row[7])).amax());
                most = most.max(solution.iterations);
            }
            last = Some(estimator.solve(&signals(&row), None).unwrap());
        }
        println!("{file}: to {worst:.1e} m and rad, {most} iterations at most");
        assert!(worst < 1e-10, "{file}: {worst:e}");
    }
}

#[test]
fn a_distant_pivot_is_a_parallel_beam() {
    let parallel = Optics::new(&head());
    let distant = optics([0.0, 0.0, 1e9]);
    for (pose, offset, _) in states(&parallel, 20) {
        let [ours, theirs] = [&distant, &parallel].map(|o| o.trace(Model::Gaussian, &pose, offset).unwrap());
        for (ours, theirs) in ours.spots.iter().zip(&theirs.spots) {
            assert!((ours - theirs).abs() < 1e-11, "{ours} {theirs}");
        }
    }
}

#[test]
fn every_state_is_found_cold_and_warm_at_any_distance() {
    for pivot in [[0.0, 0.0, 0.3], [0.002, 0.004, 0.5], [0.02, -0.01, 1.0], [-0.02, 0.0, 2.0]] {
        let optics = optics(pivot);
        let estimator = Estimator::new(optics.clone(), Model::Gaussian);
        let states = states(&optics, 100);
        let mut warm = estimator.solve(&states[99].2, None).unwrap();
        for (pose, offset, signals) in states {
            let cold = estimator.solve(&signals, None).unwrap();
            warm = estimator.solve(&signals, Some(&warm)).unwrap();
            for solution in [&cold, &warm] {
                let [ours, theirs] = [&solution.pose, &pose].map(|p| SVector::from(p.to_array()));
                assert!((ours - theirs).amax() < 1e-10, "{pivot:?}: {solution:?} {pose:?}");
                assert!((solution.offset - offset).amax() < 1e-10, "{pivot:?}: {solution:?} {offset:?}");
            }
        }
    }
}

#[test]
fn the_ray_model_follows_the_light_too() {
    let optics = optics([0.004, -0.002, 0.5]);
    let estimator = Estimator::new(optics.clone(), Model::Ray);
    for (pose, _, _) in states(&optics, 20) {
        let Ok(reading) = optics.trace(Model::Ray, &pose, Vec2::zeros()) else { continue };
        let signals = Signals { spots: reading.spots, powers: [f64::NAN; 3] };
        let solution = estimator.solve(&signals, None).unwrap();
        let [ours, theirs] = [&solution.pose, &pose].map(|p| SVector::from(p.to_array()));
        assert!((ours - theirs).amax() < 1e-11, "{solution:?} {pose:?}");
    }
}

/// The product of sensitivity and central differences of the traced signals is the identity.
#[test]
fn the_sensitivity_is_the_inverse_of_central_differences() {
    let mut turned = head();
    turned.beam_direction = Vec3::new(0.02, -0.01, -1.0).normalize();
    for (head, pivot) in [(head(), [0.0, 0.0, 0.3]), (head(), [0.02, -0.01, 1.0]), (turned, [0.0, 0.01, 0.5])]
    {
        let mut head = head;
        head.psds.iter_mut().for_each(|psd| psd.half_size *= 2.0); // room for the differences
        let optics = Optics::new(&head).from_pivot(pivot.into()).unwrap();
        let estimator = Estimator::new(optics.clone(), Model::Gaussian);
        for (pose, offset, signals) in states(&optics, 20) {
            let solution = estimator.solve(&signals, None).unwrap();
            let at = pose.to_array();
            let x = SVector::<f64, 8>::from([at[0], at[1], at[2], at[3], at[4], at[5], offset.x, offset.y]);
            let traced = |x: &SVector<f64, 8>| {
                let pose = Pose::from_array(std::array::from_fn(|i| x[i]));
                let (spots, powers) = optics.trace_each(Model::Gaussian, &pose, Vec2::new(x[6], x[7]));
                let [a, b, c] = spots.map(|spot| spot.unwrap());
                SVector::<f64, 9>::from([a[0], a[1], b[0], b[1], c[0], c[1], powers[0], powers[1], powers[2]])
            };
            let mut differences = SMatrix::<f64, 9, 8>::zeros();
            for k in 0..8 {
                let h = [1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-6, 1e-6][k];
                let shifted = |by: f64| {
                    let mut x = x;
                    x[k] += by;
                    traced(&x)
                };
                let slope =
                    ((shifted(h) - shifted(-h)) * 8.0 - (shifted(2.0 * h) - shifted(-2.0 * h))) / (12.0 * h);
                differences.set_column(k, &slope);
            }
            let product = estimator.sensitivity(&solution).unwrap().0 * differences;
            let error = (product - SMatrix::<f64, 8, 8>::identity()).amax();
            assert!(error < 1e-6, "{pivot:?}: {error:e}");
        }
    }
}

/// Deviations at rest for spots of 1.08 um, by the distance of the pivot: the x of the apex falls, roll grows.
#[test]
fn the_deviations_at_rest_depend_on_the_distance_of_the_pivot() {
    for (distance, tx_um, roll_urad) in
        [(0.3, 0.70, 2.51), (0.5, 0.79, 2.23), (1.0, 0.88, 2.00), (2.0, 0.93, 1.88)]
    {
        let optics = optics([0.0, 0.0, distance]);
        let reading = optics.trace(Model::Gaussian, &Pose::default(), Vec2::zeros()).unwrap();
        let estimator = Estimator::new(optics, Model::Gaussian);
        let signals = Signals { spots: reading.spots, powers: reading.powers };
        let solution = estimator.solve(&signals, None).unwrap();
        let noise = Noise { spots: [1.08e-6; 6], powers: [1e-9; 3] };
        let sigmas =
            sigmas(&estimator.sensitivity(&solution).unwrap().spread(&noise).pose_covariance()) * 1e6;
        println!("{distance} m: {sigmas:.3?}");
        assert!((sigmas[0] / tx_um - 1.0).abs() < 0.015 && (sigmas[3] / roll_urad - 1.0).abs() < 0.015);
        assert!((sigmas[2] - 0.623).abs() < 0.01 && (sigmas[5] - 2.494).abs() < 0.01, "tz and yaw as before");
    }
}

#[test]
fn powers_and_single_spots_give_the_offset() {
    let optics = optics([0.004, -0.002, 0.5]);
    for (pose, offset, signals) in states(&optics, 20) {
        let found = optics.offset_of_powers(&signals.powers, &pose).unwrap();
        assert!((found - offset).norm() < 1e-11, "{found:?} {offset:?}");
    }
    let pose = Pose::from_array([1e-4, -2e-4, 5e-5, 3e-3, -2e-3, 5e-3]);
    for (facet, direction) in [(0, 0.3_f64), (1, 2.2), (2, -1.8)] {
        let offset = Vec2::new(direction.cos(), direction.sin()) * 1.5e-3;
        let (spots, powers) = optics.trace_each(Model::Gaussian, &pose, offset);
        assert!(powers[facet] > 0.9999);
        let found = optics.facet_offset(facet, spots[facet].unwrap(), &pose).unwrap();
        assert!((found.offset - offset).norm() < 1e-9, "{facet}: {found:?} {offset:?}");
        assert!(found.distance() > 0.7e-3, "{found:?}");
    }
}

#[test]
fn a_round_ellipse_is_a_round_beam() {
    let optics = optics([0.004, -0.002, 0.5]);
    for (pose, offset, signals) in states(&optics, 5) {
        let (spots, _) = optics.trace_elliptical(&Ellipse::new(0.0, 0.0), &pose, offset);
        for (i, spot) in spots.into_iter().enumerate() {
            let [u, v] = spot.unwrap();
            assert!((u - signals.spots[2 * i]).hypot(v - signals.spots[2 * i + 1]) < 1e-15);
        }
    }
}

#[test]
fn a_pivot_that_is_not_above_the_apex_is_refused() {
    for pivot in [[0.0, 0.0, 0.01], [0.0, 0.0, -1.0], [f64::NAN, 0.0, 1.0], [0.0, 0.0, f64::INFINITY]] {
        let error = Optics::new(&head()).from_pivot(pivot.into()).unwrap_err().to_string();
        assert!(error.contains("at least 50 mm above the apex"), "{error}");
    }
}

#[test]
fn signals_without_light_are_refused_with_a_reason() {
    let estimator = Estimator::new(optics([0.0, 0.0, 0.5]), Model::Gaussian);
    let signals = Signals { spots: [0.0; 6], powers: [1.0, 0.0, 1.0] };
    assert!(matches!(estimator.solve(&signals, None), Err(SolveError::Dark { psd: 'B', .. })));
    let signals = Signals { spots: [6e-3, -6e-3, 6e-3, 6e-3, -6e-3, 6e-3], powers: [1.0, 1e-8, 1.0] };
    assert!(estimator.solve(&signals, None).is_err());
}

/// A beam position that agrees leaves the pose as it is, and lowers its uncertainty; another one moves it consistently.
#[test]
fn a_beam_position_is_where_the_axis_crosses_the_plane_of_the_apex_at_rest() {
    let pivot = Vec3::new(0.004, -0.002, 0.5);
    let optics = optics(pivot.into());
    let estimator = Estimator::new(optics.clone(), Model::Gaussian);
    for (pose, offset, signals) in states(&optics, 20) {
        let crossing = |t: Vec3, offset: Vec2| {
            let light = t + offset.push(0.0) - pivot;
            (pivot - light * (pivot.z / light.z)).xy()
        };
        let solution = estimator.solve(&signals, None).unwrap();
        let noise = Noise { spots: [1.08e-6; 6], powers: signals.powers.map(|power| 1e-3 * power) };
        let spread = estimator.sensitivity(&solution).unwrap().spread(&noise);
        let at = crossing(pose.t, offset);
        let fused = |at| {
            let beam_position = BeamPosition { at, sigma: 1e-9 };
            Innovation::new(&optics, &solution, &spread, &beam_position).unwrap().fuse(&solution)
        };
        let same = fused(at);
        assert!((same.pose.t - pose.t).norm() < 1e-10 && (same.offset - offset).norm() < 1e-10);
        let [before, after] = [spread.pose_covariance(), same.spread.pose_covariance()].map(|c| sigmas(&c));
        assert!(after[0] < 0.5 * before[0] && after[1] < 0.5 * before[1], "{before} {after}");
        let moved = at + Vec2::new(3e-7, -2e-7);
        let update = fused(moved);
        assert!((crossing(update.pose.t, update.offset) - moved).norm() < 1e-9, "{update:?}");
    }
}
