//! The law of propagation of uncertainty for several measurands (JCGM 100, 5.1.2 and 5.2.2).

use nalgebra::DMatrix;

use crate::Input;
use crate::student;

/// Why there is no budget.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BudgetError {
    /// A matrix has another number of rows or columns than there are inputs.
    #[error("the matrix of {what} is {rows} x {columns}, but there are {inputs} inputs")]
    Size {
        /// "sensitivities" or "correlations".
        what: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
        /// Number of inputs.
        inputs: usize,
    },
    /// A standard uncertainty or a sensitivity is not a finite number, or a deviation is negative.
    #[error("{name}: {value} is not {allowed}")]
    Value {
        /// Name of the input.
        name: String,
        /// The value.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The correlations are not those of any quantities.
    #[error(
        "the correlations of the inputs are not symmetric, not 1 on the diagonal, or contradict each other"
    )]
    Correlation,
}

/// The budget of one or several measurands.
#[derive(Clone, Debug)]
pub struct Budget {
    inputs: Vec<Input>,
    sensitivities: DMatrix<f64>,
    correlation: Option<DMatrix<f64>>,
    /// Contributions c_i u_i: a row per measurand, a column per input.
    contributions: DMatrix<f64>,
    covariance: DMatrix<f64>,
}

impl Budget {
    /// The budget of measurands with these sensitivities (a row per measurand, a column per input). `correlation`:
    /// that of the inputs; `None` if they are independent.
    ///
    /// # Errors
    /// A matrix has the wrong size, a number is not finite, or the correlations are not possible.
    pub fn new(
        inputs: Vec<Input>,
        sensitivities: DMatrix<f64>,
        correlation: Option<DMatrix<f64>>,
    ) -> Result<Self, BudgetError> {
        check(&inputs, &sensitivities, correlation.as_ref())?;
        let contributions = DMatrix::from_fn(sensitivities.nrows(), inputs.len(), |j, i| {
            sensitivities[(j, i)] * inputs[i].std
        });
        let covariance = match &correlation {
            Some(r) => &contributions * r * contributions.transpose(),
            None => &contributions * contributions.transpose(),
        };
        Ok(Self { inputs, sensitivities, correlation, contributions, covariance })
    }

    /// The inputs.
    pub fn inputs(&self) -> &[Input] {
        &self.inputs
    }

    /// Number of measurands.
    pub fn measurands(&self) -> usize {
        self.sensitivities.nrows()
    }

    /// The sensitivity of a measurand to an input.
    pub fn sensitivity(&self, measurand: usize, input: usize) -> f64 {
        self.sensitivities[(measurand, input)]
    }

    /// The correlation coefficient of two inputs.
    pub fn input_correlation(&self, a: usize, b: usize) -> f64 {
        let own = if a == b { 1.0 } else { 0.0 };
        self.correlation.as_ref().map_or(own, |r| r[(a, b)])
    }

    /// The contribution of an input, sensitivity times standard uncertainty, with its sign.
    pub fn contribution(&self, measurand: usize, input: usize) -> f64 {
        self.contributions[(measurand, input)]
    }

    /// The covariance of the measurands.
    pub fn covariance(&self) -> &DMatrix<f64> {
        &self.covariance
    }

    /// The combined standard uncertainty of a measurand.
    pub fn standard_uncertainty(&self, measurand: usize) -> f64 {
        self.covariance[(measurand, measurand)].max(0.0).sqrt()
    }

    /// The part of the variance that an input contributes by itself, 0 to 1; 0 if there is no uncertainty.
    pub fn share(&self, measurand: usize, input: usize) -> f64 {
        self.part(measurand, self.contributions[(measurand, input)].powi(2))
    }

    /// The part of the variance that comes from correlations between inputs. It may be negative. With the shares of
    /// all inputs it adds up to one.
    pub fn correlation_share(&self, measurand: usize) -> f64 {
        let own: f64 = self.contributions.row(measurand).iter().map(|c| c * c).sum();
        self.part(measurand, self.covariance[(measurand, measurand)] - own)
    }

    fn part(&self, measurand: usize, variance: f64) -> f64 {
        let whole = self.covariance[(measurand, measurand)];
        if whole > 0.0 { variance / whole } else { 0.0 }
    }

    /// The correlation coefficient of two measurands; 0 if one of them has no uncertainty.
    pub fn correlation(&self, a: usize, b: usize) -> f64 {
        let scale = self.standard_uncertainty(a) * self.standard_uncertainty(b);
        match scale > 0.0 {
            _ if a == b => 1.0,
            true => (self.covariance[(a, b)] / scale).clamp(-1.0, 1.0),
            false => 0.0,
        }
    }

    /// The effective degrees of freedom by the Welch-Satterthwaite formula (JCGM 100, G.4.1). `None`: not defined,
    /// because an input with finite degrees of freedom that matters is correlated with another one.
    ///
    /// Correlated inputs that all have infinitely many degrees of freedom act as one input of that kind.
    pub fn effective_dof(&self, measurand: usize) -> Option<f64> {
        let variance = self.covariance[(measurand, measurand)];
        let mut sum = 0.0;
        for (i, input) in self.inputs.iter().enumerate() {
            let contribution = self.contributions[(measurand, i)];
            if input.dof.is_infinite() || contribution == 0.0 {
                continue;
            }
            let others = (0..self.inputs.len()).filter(|k| *k != i);
            let matters = |k: usize| self.contributions[(measurand, k)] != 0.0;
            if others.into_iter().any(|k| matters(k) && self.input_correlation(i, k) != 0.0) {
                return None;
            }
            sum += contribution.powi(4) / input.dof;
        }
        Some(if sum > 0.0 { variance.powi(2) / sum } else { f64::INFINITY })
    }

    /// The coverage factor for a coverage probability: that of Student's t-distribution with the effective degrees
    /// of freedom, truncated to a whole number (JCGM 100, G.6.4). If they are not defined, that of the normal
    /// distribution.
    pub fn coverage_factor(&self, measurand: usize, probability: f64) -> f64 {
        let dof = self.effective_dof(measurand).unwrap_or(f64::INFINITY);
        student::coverage_factor(probability, dof.floor().max(1.0))
    }

    /// The expanded uncertainty for a coverage probability.
    pub fn expanded(&self, measurand: usize, probability: f64) -> f64 {
        self.coverage_factor(measurand, probability) * self.standard_uncertainty(measurand)
    }
}

fn check(
    inputs: &[Input],
    sensitivities: &DMatrix<f64>,
    correlation: Option<&DMatrix<f64>>,
) -> Result<(), BudgetError> {
    let count = inputs.len();
    let sized = |what, matrix: &DMatrix<f64>, fine: bool| {
        let (rows, columns) = matrix.shape();
        if fine { Ok(()) } else { Err(BudgetError::Size { what, rows, columns, inputs: count }) }
    };
    sized("sensitivities", sensitivities, sensitivities.ncols() == count)?;
    for (i, input) in inputs.iter().enumerate() {
        let wrong = |value, allowed| BudgetError::Value { name: input.name.clone(), value, allowed };
        if !(input.std.is_finite() && input.std >= 0.0) {
            return Err(wrong(input.std, "a standard uncertainty: a finite number, zero or more"));
        }
        if input.dof.is_nan() || input.dof <= 0.0 {
            return Err(wrong(input.dof, "a number of degrees of freedom: more than zero"));
        }
        if let Some(value) = sensitivities.column(i).iter().find(|c| !c.is_finite()) {
            return Err(wrong(*value, "a sensitivity: a finite number"));
        }
    }
    let Some(r) = correlation else { return Ok(()) };
    sized("correlations", r, r.shape() == (count, count))?;
    let symmetric = (0..count).all(|i| r[(i, i)] == 1.0 && (0..i).all(|k| r[(i, k)] == r[(k, i)]));
    // Rounding may make the smallest eigenvalue of a singular matrix slightly negative.
    let possible = || count == 0 || r.symmetric_eigenvalues().iter().all(|value| *value > -1e-9);
    if symmetric && possible() { Ok(()) } else { Err(BudgetError::Correlation) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Evaluation;

    #[test]
    fn correlated_inputs_add_their_cross_terms() {
        // JCGM 100, F.1.2.3 and 5.2.2: ten resistors calibrated with one standard add linearly, r = 1.
        let inputs: Vec<_> = (0..10).map(|i| Input::normal(format!("R{i}"), 1000.0, 0.1)).collect();
        let one = DMatrix::from_element(1, 10, 1.0);
        let same = DMatrix::from_element(10, 10, 1.0);
        let budget = Budget::new(inputs.clone(), one.clone(), Some(same)).unwrap();
        assert!((budget.standard_uncertainty(0) - 1.0).abs() < 1e-12);
        assert!(
            (budget.share(0, 3) - 0.01).abs() < 1e-12 && (budget.correlation_share(0) - 0.9).abs() < 1e-12
        );
        let independent = Budget::new(inputs, one, None).unwrap();
        assert!((independent.standard_uncertainty(0) - 0.1 * 10.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(independent.correlation_share(0), 0.0);
    }

    #[test]
    fn two_measurands_of_common_inputs_are_correlated() {
        // Sum and difference of two quantities.
        let inputs = vec![Input::normal("a", 0.0, 2.0), Input::normal("b", 0.0, 1.0)];
        let budget =
            Budget::new(inputs, DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 1.0, -1.0]), None).unwrap();
        assert!((budget.correlation(0, 1) - 3.0 / 5.0).abs() < 1e-12);
        assert_eq!((budget.correlation(0, 0), budget.measurands()), (1.0, 2));
    }

    #[test]
    fn degrees_of_freedom_are_not_defined_if_an_input_with_finite_ones_is_correlated() {
        let a = Input::normal("a", 0.0, 1.0).evaluated(Evaluation::A, 4.0);
        let inputs = vec![a, Input::normal("b", 0.0, 1.0), Input::normal("c", 0.0, 1.0)];
        let one = DMatrix::from_row_slice(2, 3, &[1.0, 1.0, 1.0, 0.0, 1.0, 1.0]);
        let mut r = DMatrix::identity(3, 3);
        (r[(1, 2)], r[(2, 1)]) = (0.5, 0.5);
        let budget = Budget::new(inputs.clone(), one.clone(), Some(r.clone())).unwrap();
        // u^2 = 1 + 1 + 1 + 2 * 0.5: 16 * 4 / 1.
        assert!((budget.effective_dof(0).unwrap() - 64.0).abs() < 1e-9);
        assert_eq!(budget.effective_dof(1), Some(f64::INFINITY));
        (r[(0, 1)], r[(1, 0)]) = (0.1, 0.1);
        let budget = Budget::new(inputs, one, Some(r)).unwrap();
        assert_eq!(budget.effective_dof(0), None);
        assert!((budget.coverage_factor(0, 0.95) - 1.96).abs() < 1e-3);
        assert_eq!(budget.effective_dof(1), Some(f64::INFINITY), "the first input does not matter here");
    }

    #[test]
    fn impossible_inputs_are_refused_by_name() {
        let inputs =
            || vec![Input::normal("a", 0.0, 1.0), Input::normal("b", 0.0, 1.0), Input::normal("c", 0.0, 1.0)];
        let one = || DMatrix::from_element(1, 3, 1.0);
        let say = |inputs, s, r| Budget::new(inputs, s, r).unwrap_err().to_string();
        assert!(say(inputs(), DMatrix::from_element(1, 2, 1.0), None).contains("1 x 2, but there are 3"));
        let mut wrong = inputs();
        wrong[1].std = -1.0;
        assert!(say(wrong, one(), None).starts_with("b: -1 is not a standard uncertainty"));
        let mut wrong = inputs();
        wrong[2].dof = 0.0;
        assert!(say(wrong, one(), None).starts_with("c: 0 is not a number of degrees"));
        assert!(Budget::new(Vec::new(), DMatrix::zeros(1, 0), Some(DMatrix::zeros(0, 0))).is_ok());
        // a with b, b with c, but a against c: no three quantities are like that.
        let r = DMatrix::from_row_slice(3, 3, &[1.0, 0.9, -0.9, 0.9, 1.0, 0.9, -0.9, 0.9, 1.0]);
        assert!(say(inputs(), one(), Some(r)).contains("contradict"));
        assert!(say(inputs(), one(), Some(DMatrix::from_element(3, 3, 0.5))).contains("1 on the diagonal"));
    }
}
