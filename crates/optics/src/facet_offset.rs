//! How far from the apex the beam is, by the light on a single PSD.
//!
//! Far from the apex all light falls on one facet, and its spot shows the height at which the beam meets
//! it: so far downhill from the apex is the beam. Along the contour of the facet the spot only shows where
//! the beam itself is.

use nalgebra::Matrix2;

use super::ray::Ray;
use super::{Optics, Pose, Vec2, model};

/// What one spot says of the beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FacetOffset {
    /// Unit vector across the beam, downhill on the facet.
    pub downhill: Vec2,
    /// Where the beam meets the facet, seen from the apex across the beam, metres; exact for a beam that
    /// falls on this facet alone and a mirror at the given pose. Half a millimetre per milliradian by which
    /// the orientation is wrong.
    pub offset: Vec2,
}

impl FacetOffset {
    /// How far downhill from the apex the beam is, metres: true also when the mirror has moved sideways.
    pub fn distance(&self) -> f64 {
        self.downhill.dot(&self.offset)
    }
}

impl Optics {
    /// What the spot (u, v in metres) on the PSD of facet 0, 1 or 2 says of the beam, for a mirror at `pose`;
    /// `None` if the facet cannot send light there.
    ///
    /// As the point of reflection moves on the plane, the reflected ray keeps its direction: the spot is an
    /// affine function of the offset, and two equations give both components.
    pub fn glimpse(&self, facet: usize, spot: [f64; 2], pose: &Pose) -> Option<FacetOffset> {
        let mirror = self.mirror(pose.t, &pose.rotation());
        let normal = mirror.normals[facet];
        if normal.z < model::MIN_FACING {
            return None;
        }
        let ray = |offset| Ray::new(&self.psds[facet], normal, mirror.t + model::on_plane(normal, offset));
        let at = |offset| Vec2::from(ray(offset).spot);
        let apex = at(Vec2::zeros());
        // One micrometre: any length gives the same slopes, up to rounding.
        let unit = 1e-6;
        let jacobian = [Vec2::x(), Vec2::y()].map(|axis| (at(axis * unit) - apex) / unit);
        let offset = Matrix2::from_columns(&jacobian).try_inverse()? * (Vec2::from(spot) - apex);
        let downhill = normal.xy().try_normalize(0.0)?;
        let reached = ray(offset).reaches() && offset.iter().all(|x| x.is_finite());
        reached.then_some(FacetOffset { downhill, offset })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Head, Model};

    fn optics() -> Optics {
        Optics::new(&Head::nominal(0.25, 0.013, std::f64::consts::FRAC_PI_4, 0.46e-3).unwrap())
    }

    #[test]
    fn a_beam_on_one_facet_shows_its_offset() {
        let pose = Pose::from_array([1e-4, -2e-4, 5e-5, 3e-3, -2e-3, 5e-3]);
        for (facet, direction) in [(0, 0.3_f64), (1, 2.2), (2, -1.8)] {
            for (distance, close) in [(0.8e-3, 1e-7), (3e-3, 1e-12)] {
                let offset = Vec2::new(direction.cos(), direction.sin()) * distance;
                let (spots, powers) = optics().trace_each(Model::Gaussian, &pose, offset);
                assert!(powers[facet] > 0.9999);
                let found = optics().glimpse(facet, spots[facet].unwrap(), &pose).unwrap();
                assert!((found.offset - offset).norm() < close, "{facet} {found:?} {offset:?}");
                assert!(found.distance() > 0.5 * distance);
            }
        }
    }

    #[test]
    fn the_distance_is_that_of_a_mirror_that_has_moved_sideways() {
        let before = Pose::default();
        let after = Pose::from_array([0.2e-3, 1e-3, 0.0, 0.0, 0.0, 0.0]);
        let offset = Vec2::new(2e-3, 0.5e-3);
        let spot = optics().trace_each(Model::Gaussian, &after, offset).0[0].unwrap();
        let found = optics().glimpse(0, spot, &before).unwrap();
        assert!((found.distance() - 2e-3).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn nonsense_shows_nothing() {
        for spot in [[f64::NAN, 0.0], [0.0, f64::INFINITY]] {
            assert_eq!(optics().glimpse(0, spot, &Pose::default()), None);
        }
        let turned = Pose::from_array([0.0, 0.0, 0.0, 0.0, 3.0, 0.0]);
        assert_eq!(optics().glimpse(0, [0.0; 2], &turned), None);
    }
}
