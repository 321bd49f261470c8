//! A budget in the formats of `trifacet budget`.

mod csv;
mod gtc;
mod html;
mod json;
mod numbers;
mod rows;
mod suncal;
mod text;

use trifacet_budget::MonteCarlo;
use trifacet_optics::Pose;

use super::assessment::Assessment;

/// A budget with everything that is printed beside it.
#[derive(Clone, Debug)]
pub struct Report {
    /// Name of the configuration.
    pub configuration: String,
    /// Whether the configuration contains a tare; otherwise the mirror is centred at the tare.
    pub tared: bool,
    /// Samples that are averaged in the pose.
    pub average: u32,
    /// Coverage probability.
    pub probability: f64,
    /// The budget.
    pub assessment: Assessment,
    /// The Monte Carlo method beside it.
    pub trials: Option<MonteCarlo>,
    /// The range of which this is the worst pose.
    pub range: Option<Range>,
}

/// The result of a search over a range.
#[derive(Clone, Debug)]
pub struct Range {
    /// Largest translation, metres.
    pub metres: f64,
    /// Largest angle, radians.
    pub radians: f64,
    /// Largest standard uncertainty of each measurand, and the pose where it occurs.
    pub largest: [(f64, Pose); 6],
}

impl Report {
    /// A table of at most 100 columns.
    pub fn text(&self) -> String {
        text::text(self)
    }

    /// A page without external resources, for A4.
    pub fn html(&self) -> String {
        html::html(self)
    }

    /// A line for each quantity and measurand.
    ///
    /// # Errors
    /// The table cannot be written.
    pub fn csv(&self) -> Result<String, ::csv::Error> {
        csv::csv(self)
    }

    /// All numbers.
    pub fn json(&self) -> String {
        json::json(self)
    }

    /// A project of the Python package `suncal`, YAML.
    pub fn suncal(&self) -> String {
        suncal::suncal(self)
    }

    /// A Python script that uses the package `GTC`.
    pub fn gtc(&self) -> String {
        gtc::gtc(self)
    }
}
