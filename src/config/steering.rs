//! `[steering]`: the stage that moves the laser.

use serde::{Deserialize, Serialize};

use super::check::{Checker, above_zero};

/// What the steering does when the daemon ends, or the lease of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnExit {
    /// Stays where it is.
    Hold,
    /// Goes to the parking position.
    Park,
}

/// `[steering]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SteeringConfig {
    /// Position at the full-scale output code.
    pub full_scale_um: f64,
    /// The command never leaves plus/minus this.
    pub limit_um: f64,
    /// The command never moves faster.
    pub slew_mm_per_s: f64,
    /// Parking position.
    pub park_um: [f64; 2],
    /// When the daemon ends.
    pub on_exit: OnExit,
    /// How long a command is good for.
    pub lease_ms: u16,
    /// When a command's lease ends.
    pub on_lease: OnExit,
}

impl Default for SteeringConfig {
    fn default() -> Self {
        Self {
            full_scale_um: 500.0,
            limit_um: 400.0,
            slew_mm_per_s: 50.0,
            park_um: [0.0; 2],
            on_exit: OnExit::Hold,
            lease_ms: 200,
            on_lease: OnExit::Hold,
        }
    }
}

impl SteeringConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("full_scale_um", self.full_scale_um, 1.0..=100_000.0);
        at.number("limit_um", self.limit_um, 1.0..=100_000.0);
        at.number("slew_mm_per_s", self.slew_mm_per_s, above_zero(10_000.0));
        at.numbers("park_um", &self.park_um, -100_000.0..=100_000.0);
        at.number("lease_ms", self.lease_ms, 10.0..=10_000.0);
        at.agree(
            self.limit_um <= self.full_scale_um,
            "limit_um",
            &["full_scale_um"],
            format!("{:?}", self.limit_um),
            format_args!("at most steering.full_scale_um, {}", self.full_scale_um),
        );
        for (i, park) in self.park_um.iter().enumerate() {
            at.agree(
                park.abs() <= self.limit_um,
                &format!("park_um[{i}]"),
                &["limit_um"],
                format!("{park:?}"),
                format_args!("within plus/minus steering.limit_um, {}", self.limit_um),
            );
        }
    }
}
