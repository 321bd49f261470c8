//! Derivatives of the model compared with central differences of the traced signals.

use nalgebra::{SMatrix, SVector};
use trifacet_optics::{Estimator, Model, Optics, Pose, Vec2};

use super::heads::{self, Draw, State};

pub type Unknowns = SVector<f64, 9>;

/// The nine signals for pose, offset (units of sigma) and total power.
fn traced(optics: &Optics, model: Model, x: &Unknowns) -> Unknowns {
    let pose = Pose::from_array([x[0], x[1], x[2], x[3], x[4], x[5]]);
    let reading = optics.trace(model, &pose, Vec2::new(x[6], x[7])).unwrap();
    let mut signals = Unknowns::zeros();
    for i in 0..6 {
        signals[i] = reading.spots[i];
    }
    for i in 0..3 {
        signals[6 + i] = reading.powers[i] * x[8];
    }
    signals
}

/// Fourth-order central differences.
pub fn differences(optics: &Optics, model: Model, at: &State, total: f64) -> SMatrix<f64, 9, 9> {
    let p = at.pose.to_array();
    let x = Unknowns::from([p[0], p[1], p[2], p[3], p[4], p[5], at.offset.x, at.offset.y, total]);
    let mut jacobian = SMatrix::<f64, 9, 9>::zeros();
    for k in 0..9 {
        let h = [1e-4, 5e-4, 5e-3 * optics.sigma(), 1e-3 * total][[0, 0, 0, 1, 1, 1, 2, 2, 3][k]];
        let shifted = |by: f64| {
            let mut x = x;
            x[k] += by;
            traced(optics, model, &x)
        };
        let slope = ((shifted(h) - shifted(-h)) * 8.0 - (shifted(2.0 * h) - shifted(-2.0 * h))) / (12.0 * h);
        jacobian.set_column(k, &slope);
    }
    jacobian
}

/// The product of sensitivity and differences is the identity, and independent of the total power.
#[test]
fn sensitivity_is_the_inverse_of_central_differences() {
    for (name, mut head) in heads::all() {
        head.psds.iter_mut().for_each(|psd| psd.half_size *= 2.0); // room for the differences
        let optics = Optics::new(&head);
        for model in [Model::Ray, Model::Gaussian] {
            let estimator = Estimator::new(optics.clone(), model);
            let mut draw = Draw::new(4);
            let mut worst: f64 = 0.0;
            for _ in 0..50 {
                let mut at = draw.state(&optics, model, 0.4, 0.0);
                if model == Model::Gaussian {
                    at.offset = Vec2::new(draw.within(1.0), draw.within(1.0)) * optics.sigma();
                    let Ok(reading) = optics.trace(model, &at.pose, at.offset) else { continue };
                    at.signals = heads::signals(&reading);
                }
                let total = 0.8e-3;
                at.signals.powers = at.signals.powers.map(|p| p * total);
                let solution = estimator.solve(&at.signals, None).unwrap();
                let sensitivity = estimator.sensitivity(&solution).unwrap().0;
                let product: SMatrix<f64, 8, 9> = match model {
                    Model::Gaussian => sensitivity * differences(&optics, model, &at, total),
                    Model::Ray => {
                        let mut jacobian = differences(&optics, model, &at, total);
                        jacobian.fixed_rows_mut::<3>(6).fill(0.0);
                        let mut product: SMatrix<f64, 8, 9> = sensitivity * jacobian;
                        product[(6, 6)] += 1.0; // the ray model has no offset
                        product[(7, 7)] += 1.0;
                        product
                    }
                };
                let mut product = product;
                product.column_mut(8).scale_mut(total);
                let error = (product - SMatrix::<f64, 8, 9>::identity()).amax();
                worst = worst.max(error);
            }
            println!("{name}, {model:?}: error of the sensitivity {worst:.1e} at most");
            assert!(worst < 1e-7, "{name}, {model:?}: {worst:e}");
        }
    }
}
