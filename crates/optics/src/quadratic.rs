//! Smooth functions of a pose, tabulated as quadratic polynomials of its six coordinates.

use serde::{Deserialize, Serialize};

/// Coordinates of a pose.
const AXES: usize = 6;
/// Terms of the polynomial: 1, six linear, 21 quadratic.
const TERMS: usize = 28;

/// Several functions of tx, ty, tz (m), roll, pitch, yaw (rad).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quadratic {
    /// The coordinates are divided by these.
    steps: [f64; AXES],
    /// For each term the coefficient of each function.
    coefficients: Vec<f64>,
}

impl Quadratic {
    /// Interpolates functions by their values at the zero pose and at one step on each axis and on each pair of axes,
    /// to both sides. `steps`: metres, radians. `None` if `f` is `None` at one of these poses.
    pub fn new(steps: [f64; 2], mut f: impl FnMut([f64; AXES]) -> Option<Vec<f64>>) -> Option<Self> {
        let [metres, radians] = steps;
        let steps = [metres, metres, metres, radians, radians, radians];
        let mut even_odd = |along: &[usize]| {
            let mut pose = [0.0; AXES];
            for axis in along {
                pose[*axis] = steps[*axis];
            }
            let (plus, minus) = (f(pose)?, f(pose.map(|x| -x))?);
            let combine = |sign: f64| plus.iter().zip(&minus).map(|(p, m)| 0.5 * (p + sign * m)).collect();
            Some([combine(1.0), combine(-1.0)])
        };
        let [centre, _]: [Vec<f64>; 2] = even_odd(&[])?;
        let less = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a - b).collect() };
        let (mut linear, mut squares) = (Vec::new(), Vec::new());
        for axis in 0..AXES {
            let [even, odd] = even_odd(&[axis])?;
            linear.push(odd);
            squares.push(less(&even, &centre));
        }
        let mut coefficients = centre.clone();
        coefficients.extend(linear.iter().flatten());
        for i in 0..AXES {
            for k in 0..i {
                let [even, _] = even_odd(&[i, k])?;
                coefficients.extend(less(&less(&less(&even, &centre), &squares[i]), &squares[k]));
            }
            coefficients.extend(&squares[i]);
        }
        Some(Self { steps, coefficients })
    }

    /// Number of functions.
    pub fn width(&self) -> usize {
        self.coefficients.len() / TERMS
    }

    /// Whether all numbers are usable.
    pub fn is_usable(&self, width: usize) -> bool {
        self.coefficients.len() == TERMS * width
            && self.coefficients.iter().all(|x| x.is_finite())
            && self.steps.iter().all(|x| *x > 0.0)
    }

    /// The values of the functions at a pose.
    pub fn at(&self, pose: &[f64; AXES], values: &mut [f64]) {
        let x: [f64; AXES] = std::array::from_fn(|i| pose[i] / self.steps[i]);
        let mut terms = [1.0; TERMS];
        terms[1..=AXES].copy_from_slice(&x);
        let pairs = (0..AXES).flat_map(|i| (0..=i).map(move |k| (i, k)));
        for (term, (i, k)) in terms[1 + AXES..].iter_mut().zip(pairs) {
            *term = x[i] * x[k];
        }
        values.fill(0.0);
        for (term, row) in terms.iter().zip(self.coefficients.chunks_exact(values.len().max(1))) {
            for (value, coefficient) in values.iter_mut().zip(row) {
                *value += term * coefficient;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quadratic_function_is_reproduced_and_a_cubic_one_at_its_steps() {
        let f = |x: [f64; 6]| {
            let square =
                3.0 + 2e3 * x[0] - x[5] * 100.0 + 1e6 * x[1] * x[2] - 1e5 * x[3] * x[3] + 1e5 * x[0] * x[4];
            Some(vec![square, 1e9 * x[0].powi(3)])
        };
        let quadratic = Quadratic::new([1e-3, 5e-3], f).unwrap();
        assert!(quadratic.width() == 2 && quadratic.is_usable(2));
        let pose = [0.7e-3, -0.4e-3, 1.2e-3, 3e-3, -2e-3, 6e-3];
        let mut values = [0.0; 2];
        quadratic.at(&pose, &mut values);
        assert!((values[0] - f(pose).unwrap()[0]).abs() < 1e-12);
        quadratic.at(&[1e-3, 0.0, 0.0, 0.0, 0.0, 0.0], &mut values);
        assert!((values[1] - 1.0).abs() < 1e-12);
        assert!(Quadratic::new([1e-3, 5e-3], |x| (x[2] <= 0.0).then(Vec::new)).is_none());
    }
}
