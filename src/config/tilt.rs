//! `[steering.tilt]`: a mirror that steers the beam by tilting it.

use serde::{Deserialize, Serialize};
use trifacet_optics::tilted::NEAREST_PIVOT;
use trifacet_optics::{HeadError, Optics, Vec3};

use super::check::Checker;
use super::{Config, SteeringKind};

/// Settings of `[steering.tilt]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TiltConfig {
    /// The point about which the beam turns, world frame, millimetres.
    pub pivot_mm: Option<[f64; 3]>,
}

impl TiltConfig {
    /// `used`: this mirror steers the beam.
    pub(super) fn check(&self, mut at: Checker<'_>, used: bool) {
        at.optional_numbers("pivot_mm", self.pivot_mm.as_ref().map(|mm| &mm[..]), -100_000.0..=100_000.0);
        let needed = "the point about which the beam turns, such as [0.0, 0.0, 500.0]: steering.kind = \"tilt\" needs it";
        at.demand(self.pivot_mm.is_some() || !used, "pivot_mm", "absent", needed);
    }
}

impl Config {
    /// The optics of the head, with the beam as it is steered.
    ///
    /// # Errors
    /// The geometry does not describe a sensor head, or the beam does not come from above.
    pub fn optics(&self) -> Result<Optics, HeadError> {
        let optics = Optics::new(&self.head.build()?);
        match self.pivot_mm() {
            Some(mm) => optics.from_pivot(Vec3::from(mm) / 1e3),
            None => Ok(optics),
        }
    }

    /// The point about which the beam turns, world frame, millimetres; `None`: the beam is translated.
    pub fn pivot_mm(&self) -> Option<[f64; 3]> {
        self.steering.tilt.pivot_mm.filter(|_| self.steering.kind == SteeringKind::Tilt)
    }
}

/// Where the optics cannot be built: the key to correct, and what is allowed there.
pub(super) fn allowed_geometry(error: &HeadError) -> (&'static str, String) {
    match error {
        HeadError::Pivot { .. } => (
            "steering.tilt.pivot_mm",
            format!(
                "a point at least {} mm above the apex, against head.beam_direction",
                NEAREST_PIVOT * 1e3
            ),
        ),
        _ => ("head", "facets that face the light, counter-clockwise A, B, C".into()),
    }
}
