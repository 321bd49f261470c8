//! The forward model for the solver: the light for a state of mirror and beam.

use nalgebra::UnitQuaternion;
use serde::{Deserialize, Serialize};

use super::beam::{DARK, Split, Wedge};
use super::model::MIN_FACING;
use super::ray::Ray;
use super::{Mat3, Optics, Vec2, Vec3};

/// The unknowns, in the beam frame.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct State {
    pub t: Vec3,
    pub turn: UnitQuaternion<f64>,
    pub offset: Vec2,
}

/// The light for a state: the part on each facet, and its reflection.
pub(super) struct Light {
    pub split: Option<Split>,
    pub reflections: [Reflection; 3],
    /// Every facet faces the light, receives light, and reflects it to its PSD.
    pub valid: bool,
}

/// The light of one facet.
pub(super) struct Reflection {
    /// Power and moment; only with the Gaussian model.
    pub wedge: Option<Wedge>,
    /// The point of reflection relative to the apex.
    pub arm: Vec3,
    /// The reflected ray.
    pub ray: Ray,
}

impl Light {
    /// The light for a state, with the Gaussian model or the ray model.
    #[inline(always)]
    pub fn new<const GAUSSIAN: bool>(optics: &Optics, state: &State) -> Self {
        let r: Mat3 = state.turn.to_rotation_matrix().into_inner();
        let facets = &optics.facets;
        let normals = [r * facets[0], r * facets[1], r * facets[2]];
        let split = GAUSSIAN.then(|| Split::new(&normals, state.offset / optics.sigma));
        let reflect = |facet| Reflection::new(optics, facet, normals[facet], state, split.as_ref());
        let reflections = [reflect(0), reflect(1), reflect(2)];
        let valid = normals.iter().all(|n| n.z > MIN_FACING)
            && reflections.iter().all(|r| r.ray.reaches() && r.wedge.is_none_or(|w| w.power > DARK));
        Self { split, reflections, valid }
    }
}

impl Reflection {
    #[inline(always)]
    fn new(optics: &Optics, facet: usize, normal: Vec3, state: &State, split: Option<&Split>) -> Self {
        let wedge = split.map(|split| split.wedge(facet));
        let arm = match &wedge {
            Some(wedge) => optics.arm(wedge, normal, state.offset),
            None => Vec3::zeros(),
        };
        Self { wedge, arm, ray: Ray::new(&optics.psds[facet], normal, state.t + arm) }
    }
}
