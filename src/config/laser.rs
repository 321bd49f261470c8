//! `[laser]`: the light that is expected.

use serde::{Deserialize, Serialize};
use trifacet_core::light_checks::PowerReference;

use super::check::{Checker, above_zero};

/// Settings of `[laser]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LaserConfig {
    /// Total power on the PSDs when the optics were known to be in order, microwatts. `None`: the power is not
    /// judged.
    pub power_uw: Option<f64>,
    /// Relative difference to it beyond which the power is doubted.
    pub power_tolerance: f64,
}

impl Default for LaserConfig {
    fn default() -> Self {
        Self { power_uw: None, power_tolerance: 0.05 }
    }
}

impl LaserConfig {
    /// The reference of the total power, if there is one.
    pub fn reference(&self) -> Option<PowerReference> {
        self.power_uw.map(|uw| PowerReference { watts: uw * 1e-6, tolerance: self.power_tolerance })
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.optional("power_uw", self.power_uw, above_zero(1e9));
        at.number("power_tolerance", self.power_tolerance, above_zero(1.0));
    }
}
