//! Offset of the beam from the apex, from the light on a single PSD.
//!
//! Far from the apex all light falls on one facet. Its spot gives the height at which the beam meets the
//! facet, and from it the distance from the apex along the steepest descent. Along the contour lines of the
//! facet, the spot shows only the position of the beam itself.

use nalgebra::Matrix2;

use super::ray::Ray;
use super::{Optics, Pose, Vec2, model};

/// Information about the beam from one spot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FacetOffset {
    /// Unit vector across the beam, along the steepest descent of the facet.
    pub downhill: Vec2,
    /// Point where the beam meets the facet, relative to the apex, across the beam, metres. Exact for a beam
    /// on this facet alone and a mirror at the given pose. An error of the orientation causes half a
    /// millimetre per milliradian.
    pub offset: Vec2,
}

impl FacetOffset {
    /// Distance of the beam from the apex along the steepest descent, metres; also correct if the mirror has
    /// moved sideways.
    pub fn distance(&self) -> f64 {
        self.downhill.dot(&self.offset)
    }
}

impl Optics {
    /// Offset of the beam from the spot (u, v in metres) on the PSD of facet 0, 1 or 2, for a mirror at
    /// `pose`; `None` if the facet cannot reflect light there.
    ///
    /// As the point of reflection moves on the plane, the reflected ray keeps its direction. The spot is
    /// therefore an affine function of the offset, and two equations give both components.
    /// With a tilted beam, this holds for each direction of the light, and the direction is found by iteration.
    pub fn facet_offset(&self, facet: usize, spot: [f64; 2], pose: &Pose) -> Option<FacetOffset> {
        if self.pivot.is_some() {
            return self.tilted_facet_offset(facet, spot, pose);
        }
        let mirror = self.mirror(pose.t, &pose.rotation());
        let normal = mirror.normals[facet];
        if normal.z < model::MIN_FACING {
            return None;
        }
        let ray = |offset| Ray::new(&self.psds[facet], normal, mirror.t + model::on_plane(normal, offset));
        let at = |offset| Vec2::from(ray(offset).spot);
        let apex = at(Vec2::zeros());
        // One micrometre: any length gives the same derivatives, up to rounding.
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
                let found = optics().facet_offset(facet, spots[facet].unwrap(), &pose).unwrap();
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
        let found = optics().facet_offset(0, spot, &before).unwrap();
        assert!((found.distance() - 2e-3).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn invalid_spots_give_no_offset() {
        for spot in [[f64::NAN, 0.0], [0.0, f64::INFINITY]] {
            assert_eq!(optics().facet_offset(0, spot, &Pose::default()), None);
        }
        let turned = Pose::from_array([0.0, 0.0, 0.0, 0.0, 3.0, 0.0]);
        assert_eq!(optics().facet_offset(0, [0.0; 2], &turned), None);
    }
}
