//! `[estimation]`: computation of poses from samples.

use serde::{Deserialize, Serialize};
use trifacet_optics as optics;

use super::check::{Checker, above_zero};

/// Model of the beam.
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

/// Settings of `[estimation]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimationConfig {
    /// Model of the beam.
    pub model: Model,
    /// Number of samples per pose. Poses are computed from means over blocks that do not overlap.
    pub average: u16,
    /// Standard uncertainty of each spot coordinate, micrometres.
    pub spot_noise_um: f64,
    /// Relative standard uncertainty of each power.
    pub power_noise: f64,
    /// Standard uncertainty of the position that averaging does not reduce (geometry, calibration, stray light),
    /// x, y, z in micrometres.
    pub systematic_um: [f64; 3],
    /// The same of the rotation; roll, pitch, yaw in microradians.
    pub systematic_urad: [f64; 3],
    /// Whether the readback of the steering position is used as two more signals.
    pub fuse_steering: bool,
    /// A spot within this distance of the edge of its PSD is flagged, millimetres.
    pub edge_margin_mm: f64,
    /// UNBALANCED is set if a power differs from a third of the sum by more than this fraction of the sum.
    pub balance_limit: f64,
}

impl Default for EstimationConfig {
    fn default() -> Self {
        Self {
            model: Model::Gaussian,
            average: 1,
            spot_noise_um: 1.08,
            power_noise: 1e-3,
            systematic_um: [0.0; 3],
            systematic_urad: [0.0; 3],
            fuse_steering: false,
            edge_margin_mm: 0.5,
            balance_limit: 0.05,
        }
    }
}

impl EstimationConfig {
    /// The systematic standard uncertainties: x, y, z in metres; roll, pitch, yaw in radians.
    pub fn systematic(&self) -> [f64; 6] {
        let ([x, y, z], [roll, pitch, yaw]) = (self.systematic_um, self.systematic_urad);
        [x, y, z, roll, pitch, yaw].map(|micro| micro * 1e-6)
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("average", self.average, 1.0..=60_000.0);
        // Zero noise would give zero uncertainty, which no sensor has.
        at.number("spot_noise_um", self.spot_noise_um, 0.0001..=1000.0);
        at.number("power_noise", self.power_noise, 0.000_000_1..=1.0);
        at.numbers("systematic_um", &self.systematic_um, 0.0..=100_000.0);
        at.numbers("systematic_urad", &self.systematic_urad, 0.0..=100_000.0);
        at.number("edge_margin_mm", self.edge_margin_mm, 0.0..=100.0);
        at.number("balance_limit", self.balance_limit, above_zero(1.0));
    }
}
