//! The sensor head: geometry of the PSDs, the facets and the beam.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::{FACETS, Mat3, Vec3};

/// One position-sensitive detector: a plane with two axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Psd {
    /// Centre of the sensitive area, world frame, metres.
    pub origin: Vec3,
    /// Unit normal, towards the mirror.
    pub x: Vec3,
    /// Unit vector of the first coordinate, u.
    pub y: Vec3,
    /// Unit vector of the second coordinate, v.
    pub z: Vec3,
    /// Half the side of the sensitive area, metres.
    pub half_size: f64,
}

impl Psd {
    /// A detector with its centre at `origin`, facing along `x`, with its v-axis as close to `up` as the
    /// plane allows. `size` is the side length in metres.
    pub fn facing(origin: Vec3, x: Vec3, up: Vec3, size: f64) -> Self {
        let x = x.normalize();
        let z = (up - x * up.dot(&x)).normalize();
        Self { origin, x, y: z.cross(&x), z, half_size: size / 2.0 }
    }

    /// Whether x, y, z form a right-handed orthonormal frame and the origin is finite.
    fn is_frame(&self) -> bool {
        let axes = Mat3::from_columns(&[self.x, self.y, self.z]);
        let off = (axes.transpose() * axes - Mat3::identity()).norm();
        // False for a NaN.
        off < 1e-9 && axes.determinant() > 0.0 && self.origin.norm().is_finite()
    }
}

/// A sensor head: three PSDs, three facets and a beam.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// The PSDs A, B, C.
    pub psds: [Psd; 3],
    /// Unit normals of the facets A, B, C in the mirror frame, pointing outwards. The facets meet at the
    /// apex, the origin of that frame, and are in counter-clockwise order as seen from the laser.
    pub facets: [Vec3; 3],
    /// Unit direction of the light.
    pub beam_direction: Vec3,
    /// 1/e^2 diameter of the beam, metres.
    pub beam_diameter: f64,
}

/// Reasons why the parameters do not describe a head.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum HeadError {
    /// A length is not a positive number.
    #[error("{what} must be a positive number of metres, not {value}")]
    Length {
        /// Name of the length.
        what: &'static str,
        /// The given value.
        value: f64,
    },
    /// A vector has no direction.
    #[error("{what} must be a vector with a direction, not {value:?}")]
    Direction {
        /// Name of the vector.
        what: String,
        /// The given value.
        value: [f64; 3],
    },
    /// The axes of a detector do not span a plane.
    #[error(
        "the normal and the up direction of PSD {psd} must be finite, not zero and not along the same line"
    )]
    PsdAxes {
        /// A, B or C.
        psd: char,
    },
    /// The light does not reach the front of a facet.
    #[error("facet {facet} does not face the light")]
    FacetTurnedAway {
        /// A, B or C.
        facet: char,
    },
    /// The beam does not come from above.
    #[error(
        "the pivot of a tilted beam must be at least {} mm above the apex, against the nominal light, not {:.4} mm",
        crate::tilted::NEAREST_PIVOT * 1e3, height * 1e3
    )]
    Pivot {
        /// Height of the given pivot, metres.
        height: f64,
    },
    /// The facets are not in counter-clockwise order around the apex.
    #[error("facets A, B, C must be in counter-clockwise order around the apex, as seen from the laser")]
    FacetOrder,
}

/// The nominal head: PSDs of 13 mm at 250 mm, facets at 45 degrees, beam diameter 0.46 mm.
impl Default for Head {
    fn default() -> Self {
        let Ok(head) = Self::nominal(0.25, 0.013, 45.0_f64.to_radians(), 0.46e-3) else {
            unreachable!("the nominal dimensions are valid")
        };
        head
    }
}

impl Head {
    /// The head of the paper from four numbers, metres and radians: PSDs at `distance` in the plane of the
    /// apex at azimuths 0, +120 and -120 degrees, facets inclined by `facet_angle` to the base, light from
    /// above.
    ///
    /// # Errors
    /// A length is not a positive number, or the facets do not face the light.
    pub fn nominal(distance: f64, size: f64, facet_angle: f64, diameter: f64) -> Result<Self, HeadError> {
        let around = [0.0, TAU / 3.0, -TAU / 3.0].map(|a: f64| Vec3::new(a.cos(), a.sin(), 0.0));
        let head = Self {
            psds: around.map(|e| Psd::facing(e * distance, -e, Vec3::z(), size)),
            facets: around.map(|e| e * facet_angle.sin() + Vec3::z() * facet_angle.cos()),
            beam_direction: -Vec3::z(),
            beam_diameter: diameter,
        };
        for (what, value) in
            [("the PSD distance", distance), ("the PSD size", size), ("the beam diameter", diameter)]
        {
            if !(value.is_finite() && value > 0.0) {
                return Err(HeadError::Length { what, value });
            }
        }
        head.checked()
    }

    /// Checks the head and normalises its directions.
    ///
    /// # Errors
    /// A direction has no length, a facet does not face the light, the facets are not in counter-clockwise
    /// order, or the axes of a PSD do not form a frame.
    pub fn checked(mut self) -> Result<Self, HeadError> {
        self.beam_direction = unit("the beam direction", self.beam_direction)?;
        for (name, normal) in FACETS.iter().zip(&mut self.facets) {
            *normal = unit(&format!("the normal of facet {name}"), *normal)?;
            if normal.dot(&self.beam_direction) > -1e-3 {
                return Err(HeadError::FacetTurnedAway { facet: *name });
            }
        }
        for (psd, frame) in FACETS.into_iter().zip(&self.psds) {
            if !frame.is_frame() {
                return Err(HeadError::PsdAxes { psd });
            }
        }
        let [a, b, c] = self.facets;
        if a.cross(&b).dot(&c) <= 0.0 {
            return Err(HeadError::FacetOrder);
        }
        Ok(self)
    }
}

fn unit(what: &str, v: Vec3) -> Result<Vec3, HeadError> {
    let norm = v.norm();
    if norm.is_finite() && norm > 1e-9 {
        Ok(v / norm)
    } else {
        Err(HeadError::Direction { what: what.into(), value: v.into() })
    }
}
