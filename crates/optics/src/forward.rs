//! The light that a state of mirror and beam makes: what the solver compares with the signals.

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

/// The light as a state has it: what falls on the facets, and where it is reflected to.
pub(super) struct Light {
    pub split: Option<Split>,
    pub reflections: [Reflection; 3],
    /// Every facet faces the light, is lit, and sends it to its PSD.
    pub valid: bool,
}

/// The light of one facet.
pub(super) struct Reflection {
    /// Power and moment; with the Gaussian model.
    pub wedge: Option<Wedge>,
    /// The point of reflection as seen from the apex.
    pub arm: Vec3,
    /// The ray from there.
    pub ray: Ray,
}

impl Light {
    /// The light of a state, by the Gaussian model or by that of a ray.
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
