use nalgebra::Vector6;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::*;
use crate::calibration::fit::{FIRST_FIELD, Job, fit};
use crate::calibration::map::{Lattice, degrees};
use crate::calibration::parameters::parameters;
use crate::calibration::point::Known;

/// Deviations of spots (metres), powers (relative) and reference (metres, radians).
const SPOT: f64 = 0.1e-6;
const POWER: f64 = 1e-4;
const REFERENCE: [f64; 2] = [0.1e-6, 0.5e-6];

fn normal(rng: &mut Pcg64, sigma: f64) -> f64 {
    sigma * rng.sample::<f64, _>(StandardNormal)
}

fn pose(rng: &mut Pcg64) -> Pose {
    Pose::from_array(std::array::from_fn(|i| {
        (2.0 * rng.random::<f64>() - 1.0) * if i < 3 { 0.2e-3 } else { 1e-3 }
    }))
}

/// Noisy readings of a head at poses.
fn points(head: &Calibration, poses: &[Pose], rng: &mut Pcg64) -> Vec<Point> {
    let one = |pose: &Pose| {
        let mut raw = head.reading(pose).unwrap();
        raw.spots.iter_mut().for_each(|spot| *spot += normal(rng, SPOT));
        raw.powers.iter_mut().for_each(|power| *power *= 1.0 + normal(rng, POWER));
        let reference = pose.to_array();
        Point {
            spot_deviations: [SPOT; 6],
            power_deviations: raw.powers.map(|power| power * POWER),
            reference: std::array::from_fn(|i| {
                let deviation = REFERENCE[i / 3];
                Some(Known { value: reference[i] + normal(rng, deviation), deviation })
            }),
            ..raw.point()
        }
    };
    poses.iter().map(one).collect()
}

/// A head whose errors are those that the priors expect: geometry, polynomials, and splines.
fn drawn(like: &Calibration, rng: &mut Pcg64) -> Calibration {
    let mut theta: Vec<f64> = parameters(&like.tolerances).iter().map(|p| normal(rng, p.deviation)).collect();
    for _ in 0..6 {
        let by_degree = degrees().map(|(i, j)| like.tolerances.psd_error_um[i + j - 1] * 1e-6);
        theta.extend(by_degree.map(|sigma| normal(rng, sigma)));
    }
    theta.resize(like.theta.len(), 0.0);
    for psd in 0..3 {
        let lattice = &like.layout.lattices[psd];
        let root = nalgebra::Cholesky::new(lattice.covariance(&like.field)).unwrap().l();
        for coordinate in 0..2 {
            let unit = nalgebra::DVector::from_fn(lattice.len(), |_, _| normal(rng, 1.0));
            let from = like.layout.splines(psd, coordinate);
            theta[from..from + lattice.len()].copy_from_slice((&root * unit).as_slice());
        }
    }
    Calibration { theta, ..like.clone() }
}

/// The stated covariance is that of the errors, for heads as the priors expect them: averaged over heads, tares and
/// poses, the normalised error squared is six. All poses of a head have errors in common, so the heads scatter.
#[test]
fn the_errors_of_heads_as_the_priors_expect_them_are_as_large_as_stated() {
    const HEADS: usize = 40;
    let mut rng = Pcg64::seed_from_u64(5);
    // Small enough for all light to reach the PSDs.
    let tolerances = Tolerances {
        psd_position_mm: 0.3,
        psd_rotation_mrad: 5.0,
        facet_mrad: 1.0,
        frame_mm: 0.05,
        frame_mrad: 2.0,
        ..Tolerances::default()
    };
    let identity = Rigid::identity();
    let nominal = Nominal {
        head: Head::default(),
        steering_matrix: Matrix2::identity(),
        steering_origin: Vector2::zeros(),
        stage: identity,
        table: identity,
    };
    let fitted = |points: &[Point]| {
        let job = Job { nominal: &nominal, tolerances: &tolerances, points, fields: &[FIRST_FIELD] };
        fit(job, |_| ()).unwrap().calibration
    };
    let nodes: Vec<Pose> = (0..40).map(|_| pose(&mut rng)).collect();
    let layout = Layout { runs: 0, lattices: [0, 1, 2].map(|_| lattice()), half_sizes: [HALF_SIZE; 3] };
    let drawing = Calibration {
        nominal: nominal.clone(),
        tolerances: tolerances.clone(),
        theta: vec![0.0; layout.parameters()],
        layout,
        field: FIRST_FIELD,
        factor: Factor::new(Matrix::identity(1, 1)).unwrap(),
    };
    let mut each = Vec::new();
    for _ in 0..HEADS {
        let truth = drawn(&drawing, &mut rng);
        let found = fitted(&points(&truth, &nodes, &mut rng));
        let instruments = Neighbours::new(&found.nominal, &found.theta);
        let (mut sum, mut count) = (0.0, 0.0);
        for _ in 0..4 {
            let poses: Vec<Pose> = (0..7).map(|_| pose(&mut rng)).collect();
            let raws: Vec<Raw> = poses.iter().map(|pose| truth.reading(pose).unwrap()).collect();
            let seen: Vec<Pose> =
                raws.iter().map(|raw| found.seen(&instruments, raw).unwrap().pose).collect();
            let relative = |of: &[Pose], k: usize| {
                Pose::from(&(Rigid::from(&of[0]).inverse() * Rigid::from(&of[k]))).to_array()
            };
            let covariances = found.relative_covariances(&raws[1..], &raws[0]).unwrap();
            for (k, covariance) in (1..).zip(covariances) {
                let error = Vector6::from(relative(&seen, k)) - Vector6::from(relative(&poses, k));
                sum += error.dot(&(covariance.unwrap().try_inverse().unwrap() * error));
                count += 1.0;
            }
        }
        each.push(sum / count);
    }
    let mean = each.iter().sum::<f64>() / HEADS as f64;
    println!("normalised error squared, mean of {HEADS} heads: {mean:.2}");
    assert!((5.7..6.3).contains(&mean), "{mean}: {each:.1?}");
}

const HALF_SIZE: f64 = 6.5e-3;

/// Splines wherever the light of these poses may go.
fn lattice() -> Lattice {
    let place = |k: i32| f64::from(k) * 0.3e-3;
    let grid = (-12..=12).flat_map(move |i| (-12..=12).map(move |j| [place(i), place(j)]));
    Lattice::new(FIRST_FIELD.knots, HALF_SIZE, grid)
}
