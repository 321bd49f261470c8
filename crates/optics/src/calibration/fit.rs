//! The estimator: Gauss-Newton steps over all points, gross errors, and the choice of the prior of the splines.

use super::Vector;
use super::held_out::HeldOut;
use super::map::Field;
use super::parameters::{Nominal, Tolerances};
use super::point::Point;
use super::pointing::Pointing;
use super::result::Calibration;
use super::session::Session;

/// Priors of the splines and the logarithms of their likelihoods, up to a common constant.
pub type Likelihoods = Vec<(Field, f64)>;

/// What is to be fitted.
#[derive(Clone, Copy, Debug)]
pub struct Job<'a> {
    /// The head before the fit.
    pub nominal: &'a Nominal,
    /// How far it may be from that.
    pub tolerances: &'a Tolerances,
    /// All points.
    pub points: &'a [Point],
    /// The priors of the splines among which the most likely one is chosen; at least one.
    pub fields: &'a [Field],
}

/// The first prior of the splines: good for finding gross errors.
pub const FIRST_FIELD: Field = Field { knots: 0.65e-3, rms: 2e-6, length: 0.5e-3 };

/// The prior near which the search for the most likely one begins.
pub(super) const USUAL_FIELD: Field = Field { knots: 0.65e-3, rms: 1e-6, length: 0.7e-3 };

/// The priors among which a calibration chooses, well beyond what PSDs are known to have on all sides.
pub fn fields() -> Vec<Field> {
    let mut fields = Vec::new();
    for knots in [0.65e-3, 0.5e-3] {
        for rms in [0.5e-6, 1e-6, 2e-6, 4e-6, 8e-6] {
            fields.extend([0.5e-3, 0.7e-3, 1e-3, 1.4e-3].map(|length| Field { knots, rms, length }));
        }
    }
    fields
}

/// How far a fit is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// A step, with the cost per row.
    Step {
        /// What the steps are for.
        stage: Stage,
        /// Number of the step in this stage.
        step: usize,
        /// Cost per row, 0.6 to 1.2 for a good fit.
        cost: f64,
    },
    /// A prior was judged.
    Prior {
        /// The prior.
        field: Field,
        /// Logarithm of its likelihood, up to a constant.
        ln_likelihood: f64,
    },
}

/// The stages of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Two steps with all points.
    First,
    /// Steps in which points with large errors count less.
    Robust,
    /// Steps with the points that remain.
    Last,
}

/// Reasons why there is no fit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// No point has a solution.
    #[error("none of the {0} points has a solution with the nominal head")]
    NoPoints(usize),
    /// The equations are singular.
    #[error(
        "the normal equations are not positive definite: a deviation or a tolerance is not a usable number"
    )]
    Singular,
    /// The steps do not converge.
    #[error("the fit does not converge within {steps} steps: the head is too far from its tolerances")]
    NotConverged {
        /// Number of steps.
        steps: usize,
        /// The residual of the steering after them, if it is larger than stated: the more likely cause.
        pointing: Option<Pointing>,
    },
}

/// Why a point has no part in the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Dropped {
    /// Its signals have no solution with the nominal head.
    Unsolved,
    /// Its errors are too large: chi-square, and the number of its rows.
    Gross {
        /// Sum of its squared errors, each in units of its deviation.
        chi2: f64,
        /// Number of its errors.
        rows: usize,
    },
}

/// The result of a fit.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The calibrated head.
    pub calibration: Calibration,
    /// Points that have no part in it, with their index.
    pub dropped: Vec<(usize, Dropped)>,
    /// Chi-square of each point; `None` for dropped ones.
    pub chi2: Vec<Option<f64>>,
    /// Sum of the squared errors, and the share of the prior.
    pub cost: f64,
    /// Number of rows.
    pub rows: usize,
    /// The candidates for the prior of the splines and the logarithms of their likelihoods.
    pub likelihoods: Likelihoods,
    /// How well a fit without every tenth point predicts these points.
    pub held_out: HeldOut,
    /// Residuals of the steering position of each point, x and y, metres; `None`: dropped or not measured.
    pub steering: Vec<Option<[f64; 2]>>,
    /// The residual of the steering before points were dropped, if it is larger than stated.
    pub pointing: Option<Pointing>,
}

impl Fitted {
    /// Cost per row.
    pub fn cost_per_row(&self) -> f64 {
        self.cost / self.rows as f64
    }
}

/// Points with a chi-square that has a smaller probability than this are dropped.
pub(super) const IMPROBABLE: f64 = 1e-7;
/// Fits all parameters to the points.
///
/// # Errors
/// No point has a solution, or the steps do not converge.
pub fn fit(job: Job<'_>, mut progress: impl FnMut(Progress)) -> Result<Fitted, FitError> {
    let mut session = Session::new(job, job.fields[0].knots)?;
    let first = job.fields.iter().find(|f| **f == FIRST_FIELD).unwrap_or(&job.fields[0]);
    session.set_field(first)?;
    let mut theta = Vector::zeros(session.layout.parameters());
    session.steps(&mut theta, Stage::First, &mut progress)?;
    let robust = session.steps(&mut theta, Stage::Robust, &mut progress)?;
    let pointing = robust.pointing(&job);
    let dropped = session.drop_gross(&robust);
    let mut likelihoods = Vec::new();
    if job.fields.len() > 1 {
        theta = session.choose(&theta, &mut likelihoods, &mut progress)?;
    }
    session.steps(&mut theta, Stage::Last, &mut progress)?;
    let held_out = session.held_out(&theta)?;
    let last = session.assess(&theta, false).ok_or(FitError::Singular)?;
    let fitted = session.result(&theta, &last, (dropped, likelihoods, held_out))?;
    Ok(Fitted { pointing, ..fitted })
}

/// The probability that chi-square with `d` degrees of freedom exceeds `x`.
pub(super) fn tail(d: usize, x: f64) -> f64 {
    let half = 0.5 * x;
    let (mut term, mut sum, mut k) = if d.is_multiple_of(2) {
        ((-half).exp(), 0.0, 0.0)
    } else {
        let root = half.sqrt();
        ((-half).exp() * root / (0.5 * std::f64::consts::PI.sqrt()), libm::erfc(root), 0.5)
    };
    let terms = d / 2;
    for _ in 0..terms {
        sum += term;
        k += 1.0;
        term *= half / k;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_of_chi_square_are_those_of_the_tables() {
        for (d, x) in [(1, 3.841), (2, 5.991), (3, 7.815), (6, 12.592), (8, 15.507)] {
            assert!((tail(d, x) - 0.05).abs() < 2e-5, "{d} {}", tail(d, x));
        }
        assert!((tail(5, 20.515) - 0.001).abs() < 1e-6);
        assert!(tail(8, 50.0) < 1e-7 && tail(0, 1.0) == 0.0);
    }
}
