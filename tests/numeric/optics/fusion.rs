//! The fusion of eleven signals compared with a direct weighted least-squares solution.

use nalgebra::{SMatrix, SVector};
use trifacet_optics::{BeamPosition, Estimator, Innovation, Model, Noise, Optics, Pose, Vec2};

use super::heads::{self, Draw};
use super::slopes::{Unknowns, differences};

const BEAM_SIGMA: f64 = 0.1e-6;

/// The point at which the beam crosses the plane of the apex, from its offset.
fn beam(optics: &Optics, x: &Unknowns) -> Vec2 {
    let pose = Pose::from_array([x[0], x[1], x[2], x[3], x[4], x[5]]);
    optics.across(pose.t) + Vec2::new(x[6], x[7])
}

/// For all heads, including the oblique beam: the weighted solution of eleven equations, linearised by
/// central
/// differences and solved together, equals the update of the solution from nine signals.
#[test]
fn fusion_is_the_weighted_solution_of_eleven_equations() {
    for (name, mut head) in heads::all() {
        head.psds.iter_mut().for_each(|psd| psd.half_size *= 2.0); // room for the differences
        let optics = Optics::new(&head);
        let estimator = Estimator::new(optics.clone(), Model::Gaussian);
        let mut draw = Draw::new(7);
        let mut worst: f64 = 0.0;
        for _ in 0..50 {
            let mut at = draw.state(&optics, Model::Gaussian, 0.4, 0.0);
            let total = 0.8e-3;
            at.signals.powers = at.signals.powers.map(|p| p * total);
            let noise = Noise { spots: [1.08e-6; 6], powers: at.signals.powers.map(|p| 1e-3 * p) };
            let solution = estimator.solve(&at.signals, None).unwrap();
            let p = solution.pose.to_array();
            let offset = solution.offset;
            let x = Unknowns::from([p[0], p[1], p[2], p[3], p[4], p[5], offset.x, offset.y, total]);

            let residual = Vec2::new(draw.within(2e-6), draw.within(2e-6));
            let beam_position = BeamPosition { at: beam(&optics, &x) + residual, sigma: BEAM_SIGMA };
            let spread = estimator.sensitivity(&solution).unwrap().spread(&noise);
            let innovation = Innovation::new(&optics, &solution, &spread, &beam_position).unwrap();
            let fused = innovation.fuse(&solution);

            // Each row is divided by its standard uncertainty.
            let mut rows = SMatrix::<f64, 11, 9>::zeros();
            let nine = differences(&optics, Model::Gaussian, &at, total);
            for (i, deviation) in noise.spots.iter().chain(&noise.powers).enumerate() {
                rows.set_row(i, &(nine.row(i) / *deviation));
            }
            for k in 0..9 {
                let mut moved = x;
                moved[k] += 1e-3;
                let slope = (beam(&optics, &moved) - beam(&optics, &x)) / 1e-3 / BEAM_SIGMA;
                (rows[(9, k)], rows[(10, k)]) = (slope.x, slope.y);
            }
            let mut right = SVector::<f64, 11>::zeros();
            right.fixed_rows_mut::<2>(9).copy_from(&(residual / BEAM_SIGMA));
            let qr = rows.qr();
            let step = qr.r().solve_upper_triangular(&(qr.q().transpose() * right)).unwrap();
            let root = qr.r().try_inverse().unwrap();
            let covariance = (root * root.transpose()).fixed_view::<6, 6>(0, 0).into_owned();

            let stated = fused.spread.pose_covariance();
            for i in 0..6 {
                let deviation = covariance[(i, i)].sqrt();
                let update = fused.pose.to_array()[i] - p[i];
                worst = worst.max((update - step[i]).abs() / deviation);
                for k in 0..6 {
                    let unit = deviation * covariance[(k, k)].sqrt();
                    worst = worst.max((stated[(i, k)] - covariance[(i, k)]).abs() / unit);
                }
            }
            for i in 0..2 {
                worst = worst.max(((fused.offset - offset)[i] - step[6 + i]).abs() / BEAM_SIGMA);
            }
            let by_hand = ((rows * step - right).norm_squared()).sqrt();
            worst = worst.max((innovation.normalized_residual() - by_hand).abs());
        }
        println!("{name}: error of the fusion {worst:.1e} sigma at most");
        assert!(worst < 1e-5, "{name}: {worst:e}");
    }
}
