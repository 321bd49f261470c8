//! `[tune]`: limits of `trifacet tune`.

use serde::{Deserialize, Serialize};

use super::check::{Checker, above_zero};

/// Settings of `[tune]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TuneConfig {
    /// A larger origin is not written without `--accept-origin`, micrometres.
    pub origin_limit_um: f64,
}

impl Default for TuneConfig {
    fn default() -> Self {
        Self { origin_limit_um: 100.0 }
    }
}

impl TuneConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("origin_limit_um", self.origin_limit_um, above_zero(100_000.0));
    }
}
