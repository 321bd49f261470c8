//! Draws from the distributions of the inputs (JCGM 101, 6.4).

use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution as _, StandardNormal, StudentT};
use rand_pcg::Pcg64;

use crate::{Distribution, Input};

/// Why the inputs cannot be drawn.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SamplerError {
    /// Only normally distributed inputs can be correlated.
    #[error("{0} is correlated with another input, but not normally distributed")]
    NotNormal(String),
    /// Student's t-distribution has a positive number of degrees of freedom.
    #[error("{name} has a t-distribution with {dof} degrees of freedom: allowed is a finite number above 0")]
    DegreesOfFreedom {
        /// Name of the input.
        name: String,
        /// The number.
        dof: f64,
    },
}

/// Draws values of the inputs. The same seed gives the same values on every machine.
#[derive(Clone, Debug)]
pub struct Sampler {
    inputs: Vec<Input>,
    /// Of each input with Student's t-distribution.
    student: Vec<Option<StudentT<f64>>>,
    /// Correlated inputs, and a square root of their correlation matrix.
    correlated: Vec<usize>,
    root: DMatrix<f64>,
    rng: Pcg64,
}

impl Sampler {
    /// A sampler of inputs with this correlation; `None` if they are independent.
    ///
    /// # Errors
    /// An input that is not normally distributed is correlated, or a t-distribution has no valid degrees of
    /// freedom.
    pub fn new(
        inputs: &[Input],
        correlation: Option<&DMatrix<f64>>,
        seed: u64,
    ) -> Result<Self, SamplerError> {
        let count = inputs.len();
        let related = |i: usize, r: &DMatrix<f64>| (0..count).any(|k| k != i && r[(i, k)] != 0.0);
        let correlated: Vec<_> =
            correlation.map_or(Vec::new(), |r| (0..count).filter(|i| related(*i, r)).collect());
        if let Some(i) = correlated.iter().find(|i| inputs[**i].distribution != Distribution::Normal) {
            return Err(SamplerError::NotNormal(inputs[*i].name.clone()));
        }
        let student = inputs.iter().map(student).collect::<Result<_, _>>()?;
        let root = correlation.map_or(DMatrix::zeros(0, 0), |r| root(r, &correlated));
        Ok(Self { inputs: inputs.to_vec(), student, correlated, root, rng: Pcg64::seed_from_u64(seed) })
    }

    /// Draws a value of each input.
    pub fn draw(&mut self, values: &mut Vec<f64>) {
        values.clear();
        for (input, student) in self.inputs.iter().zip(&self.student) {
            values.push(
                input.value + input.std * standard(input.distribution, student.as_ref(), &mut self.rng),
            );
        }
        // The independent normal values of the correlated inputs, in units of their deviations, are mixed.
        let normal: Vec<f64> = self.correlated.iter().map(|_| self.rng.sample(StandardNormal)).collect();
        for (row, i) in self.correlated.iter().enumerate() {
            let mixed: f64 = normal.iter().enumerate().map(|(k, x)| self.root[(row, k)] * x).sum();
            values[*i] = self.inputs[*i].value + self.inputs[*i].std * mixed;
        }
    }
}

fn student(input: &Input) -> Result<Option<StudentT<f64>>, SamplerError> {
    if input.distribution != Distribution::StudentT {
        return Ok(None);
    }
    let wrong = || SamplerError::DegreesOfFreedom { name: input.name.clone(), dof: input.dof };
    if !input.dof.is_finite() {
        return Err(wrong());
    }
    StudentT::new(input.dof).map(Some).map_err(|_| wrong())
}

/// A value in units of the standard uncertainty.
fn standard(distribution: Distribution, student: Option<&StudentT<f64>>, rng: &mut Pcg64) -> f64 {
    let half = distribution.half_width().unwrap_or(1.0);
    let mut uniform = || rng.random::<f64>();
    match distribution {
        Distribution::Normal => rng.sample(StandardNormal),
        Distribution::StudentT => student.map_or(f64::NAN, |t| t.sample(rng)),
        Distribution::Rectangular => half * (2.0 * uniform() - 1.0),
        // JCGM 101, 6.4.3.4: limits that move together, the lower one within -1 -+ inexactness.
        Distribution::CurvilinearTrapezoid { inexactness } => {
            let low = -1.0 + inexactness * (2.0 * uniform() - 1.0);
            half * (low - 2.0 * low * uniform())
        }
        Distribution::Triangular => half * (uniform() + uniform() - 1.0),
        Distribution::Arcsine => half * (std::f64::consts::TAU * uniform()).sin(),
    }
}

/// A square root of the correlation matrix of some inputs. By eigenvalues, because the matrix may be singular.
fn root(correlation: &DMatrix<f64>, of: &[usize]) -> DMatrix<f64> {
    let part = DMatrix::from_fn(of.len(), of.len(), |i, k| correlation[(of[i], of[k])]);
    if part.is_empty() {
        return part;
    }
    let mut eigen = part.symmetric_eigen();
    for (mut column, value) in eigen.eigenvectors.column_iter_mut().zip(&eigen.eigenvalues) {
        column *= value.max(0.0).sqrt();
    }
    eigen.eigenvectors
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Standard deviation, largest absolute value and mean fourth power of many values with std 1.
    fn moments(distribution: Distribution, dof: f64) -> [f64; 3] {
        let input = Input { dof, ..Input::new("x", 0.0, 1.0, distribution) };
        let mut sampler = Sampler::new(&[input], None, 7).unwrap();
        let (mut values, mut sums, count) = (Vec::new(), [0.0_f64; 3], 200_000);
        for _ in 0..count {
            sampler.draw(&mut values);
            let x = values[0];
            sums = [sums[0] + x * x, sums[1].max(x.abs()), sums[2] + x.powi(4)];
        }
        [(sums[0] / f64::from(count)).sqrt(), sums[1], sums[2] / f64::from(count)]
    }

    #[test]
    fn each_distribution_has_its_standard_uncertainty_its_limits_and_its_shape() {
        let trapezoid = Distribution::CurvilinearTrapezoid { inexactness: 0.5 };
        // The fourth moment of the trapezoid: that of a rectangle of half-width w(1 + e), E(1 + e)^4, e within 1/2.
        let w = trapezoid.half_width().unwrap();
        let e4 = 1.0 + 6.0 * (0.25 / 3.0) + 0.0625 / 5.0;
        for (distribution, limit, fourth) in [
            (Distribution::Normal, f64::INFINITY, 3.0),
            (Distribution::Rectangular, 3.0_f64.sqrt(), 9.0 / 5.0),
            (Distribution::Triangular, 6.0_f64.sqrt(), 36.0 / 15.0),
            (Distribution::Arcsine, 2.0_f64.sqrt(), 4.0 * 3.0 / 8.0),
            (trapezoid, 1.5 * w, w.powi(4) * e4 / 5.0),
        ] {
            let [std, largest, shape] = moments(distribution, f64::INFINITY);
            assert!((std - 1.0).abs() < 0.01, "{distribution:?}: {std}");
            assert!(largest <= limit, "{distribution:?}: {largest}");
            assert!((shape / fourth - 1.0).abs() < 0.03, "{distribution:?}: {shape}, not {fourth}");
        }
        // The scale is the standard uncertainty; the deviation is larger, by the root of 18/16.
        let [std, ..] = moments(Distribution::StudentT, 18.0);
        assert!((std - (18.0_f64 / 16.0).sqrt()).abs() < 0.01, "{std}");
    }

    #[test]
    fn correlated_inputs_have_their_correlation_also_if_it_is_complete() {
        let inputs: Vec<_> = ["a", "b", "c", "d"].map(|name| Input::normal(name, 5.0, 2.0)).into();
        let mut r = DMatrix::identity(4, 4);
        for (i, k, value) in [(0, 2, -0.6), (1, 3, 1.0)] {
            (r[(i, k)], r[(k, i)]) = (value, value);
        }
        let mut sampler = Sampler::new(&inputs, Some(&r), 1).unwrap();
        let (mut values, mut sum, count) = (Vec::new(), DMatrix::<f64>::zeros(4, 4), 100_000);
        for _ in 0..count {
            sampler.draw(&mut values);
            let x = nalgebra::DVector::from_iterator(4, values.iter().map(|x| (x - 5.0) / 2.0));
            sum += &x * x.transpose() / f64::from(count);
        }
        assert!((sum - r).amax() < 0.02);
    }

    #[test]
    fn a_correlation_matrix_without_correlations_changes_nothing() {
        let inputs: Vec<_> = ["a", "b"].map(|name| Input::normal(name, 5.0, 2.0)).into();
        let draw = |correlation: Option<DMatrix<f64>>| {
            let mut values = Vec::new();
            Sampler::new(&inputs, correlation.as_ref(), 3).unwrap().draw(&mut values);
            values
        };
        assert_eq!(draw(None), draw(Some(DMatrix::identity(2, 2))));
    }

    #[test]
    fn what_cannot_be_drawn_is_refused_by_name() {
        let inputs = [Input::normal("a", 0.0, 1.0), Input::new("b", 0.0, 1.0, Distribution::Arcsine)];
        let r = DMatrix::from_row_slice(2, 2, &[1.0, 0.5, 0.5, 1.0]);
        let error = Sampler::new(&inputs, Some(&r), 1).unwrap_err();
        assert!(error.to_string().starts_with("b is correlated"), "{error}");
        let error = Sampler::new(&[Input::new("c", 0.0, 1.0, Distribution::StudentT)], None, 1).unwrap_err();
        assert!(error.to_string().contains("c has a t-distribution with inf"), "{error}");
    }
}
