//! `[estimation]`: from samples to poses.

use serde::{Deserialize, Serialize};
use trifacet_optics as optics;

use super::check::{Checker, above_zero};

/// Which model of the beam.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// A ray through the apex, as in the paper: six signals.
    Ray,
    /// A Gaussian beam: nine signals.
    Gaussian,
}

impl From<Model> for optics::Model {
    fn from(model: Model) -> Self {
        match model {
            Model::Ray => optics::Model::Ray,
            Model::Gaussian => optics::Model::Gaussian,
        }
    }
}

/// `[estimation]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimationConfig {
    /// Which model of the beam.
    pub model: Model,
    /// Samples per pose: means over blocks that do not overlap.
    pub average: u16,
    /// One standard deviation of each spot coordinate.
    pub spot_noise_um: f64,
    /// One standard deviation of each power, relative to it.
    pub power_noise: f64,
    /// The steering position by its readback counts as two more signals.
    pub fuse_steering: bool,
    /// Width of the margin on a PSD in which a spot is flagged.
    pub edge_margin_mm: f64,
    /// Largest difference of a power from a third of the sum, relative to the sum, before UNBALANCED.
    pub balance_limit: f64,
}

impl Default for EstimationConfig {
    fn default() -> Self {
        Self {
            model: Model::Gaussian,
            average: 1,
            spot_noise_um: 1.08,
            power_noise: 1e-3,
            fuse_steering: false,
            edge_margin_mm: 0.5,
            balance_limit: 0.05,
        }
    }
}

impl EstimationConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("average", self.average, 1.0..=60_000.0);
        // Noise of nothing would mean deviations of nothing, and nobody has that.
        at.number("spot_noise_um", self.spot_noise_um, 0.0001..=1000.0);
        at.number("power_noise", self.power_noise, 0.000_000_1..=1.0);
        at.number("edge_margin_mm", self.edge_margin_mm, 0.0..=100.0);
        at.number("balance_limit", self.balance_limit, above_zero(1.0));
    }
}
