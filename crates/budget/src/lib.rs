//! Uncertainty budgets, as in the *Guide to the expression of uncertainty in measurement* (JCGM 100:2008, GUM)
//! and its first supplement (JCGM 101:2008). Pure: no clock, no file, no instrument.
//!
//! - [`Input`]: an input quantity with its standard uncertainty, distribution and degrees of freedom.
//! - [`Budget`]: the law of propagation for several measurands with correlated inputs: contributions, shares,
//!   combined uncertainty, effective degrees of freedom, expanded uncertainty, correlation of the measurands.
//! - [`student`]: coverage factors from Student's t-distribution.
//! - [`monte_carlo`]: propagation of distributions through any model, with coverage intervals.
//! - [`validation`]: whether the interval of the law of propagation agrees with that of the Monte Carlo method.
//!
//! ```
//! use nalgebra::DMatrix;
//! use trifacet_budget::{Budget, Distribution, Evaluation, Input};
//!
//! // The length of a rod in micrometres: a reading, and the effect of its temperature (11 um/K).
//! let reading = Input::normal("mean of 10 readings", 0.0, 0.30).evaluated(Evaluation::A, 9.0);
//! let temperature = Input::new("temperature", 0.0, 0.05, Distribution::Rectangular);
//! let sensitivities = DMatrix::from_row_slice(1, 2, &[1.0, 11.0]);
//! let budget = Budget::new(vec![reading, temperature], sensitivities, None)?;
//!
//! assert!((budget.standard_uncertainty(0) - 0.30_f64.hypot(11.0 * 0.05)).abs() < 1e-12);
//! assert!((budget.share(0, 0) + budget.share(0, 1) + budget.correlation_share(0) - 1.0).abs() < 1e-12);
//! let dof = budget.effective_dof(0).expect("the inputs are independent");
//! assert!((dof - 171.0).abs() < 1.0, "{dof}");
//! let k = budget.coverage_factor(0, 0.95);
//! assert!((k - 1.974).abs() < 1e-3, "{k}");
//! # Ok::<(), trifacet_budget::BudgetError>(())
//! ```

mod budget;
mod input;
pub mod monte_carlo;
mod sampler;
pub mod student;
pub mod validation;

pub use budget::{Budget, BudgetError};
pub use input::{Distribution, Evaluation, Input};
pub use monte_carlo::{Interval, MonteCarlo, Stop};
pub use sampler::{Sampler, SamplerError};
pub use validation::{Validation, Verdict};
