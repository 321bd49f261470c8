//! From a point of a facet to the spot on its PSD, by the law of reflection, in the beam frame.

use super::{Psd, Vec3};

/// The direction of the light in the beam frame is -z.
pub const LIGHT: Vec3 = Vec3::new(0.0, 0.0, -1.0);

/// The reflection of one ray, and where it meets the PSD.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    normal: Vec3,
    direction: Vec3,
    /// Distance from the facet to the PSD along the ray.
    length: f64,
    toward: f64,
    /// u, v on the PSD, metres.
    pub spot: [f64; 2],
}

/// How one spot coordinate changes.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// With a translation of the point of reflection.
    pub shift: Vec3,
    /// With a turn of the mirror about the apex, seen from a point of the facet that stays on the same
    /// line along the beam.
    pub turn: Vec3,
    /// With a movement of that line across the beam (the z component is 0).
    pub across: Vec3,
}

impl Ray {
    /// Reflects the light at `point` of a facet with unit normal `normal`.
    /// `None` if the ray does not travel towards the PSD.
    pub fn new(psd: &Psd, normal: Vec3, point: Vec3) -> Option<Self> {
        let direction = LIGHT + normal * (2.0 * normal.z);
        let toward = direction.dot(&psd.x);
        let from_psd = point - psd.origin;
        let length = -from_psd.dot(&psd.x) / toward;
        let hit = from_psd + direction * length;
        let spot = [hit.dot(&psd.y), hit.dot(&psd.z)];
        (toward < 0.0 && length > 0.0).then_some(Self { normal, direction, length, toward, spot })
    }

    /// The derivatives of the coordinate along `axis` (the PSD's y or z); `arm` is the point of
    /// reflection as seen from the apex.
    pub fn row(&self, psd: &Psd, axis: Vec3, arm: Vec3) -> Row {
        let n = self.normal;
        let g = axis - psd.x * (self.direction.dot(&axis) / self.toward);
        let tilt = g.z / n.z;
        let n_cross_light = Vec3::new(-n.y, n.x, 0.0);
        let reflected = (n_cross_light * g.dot(&n) - n.cross(&g) * n.z) * (-2.0 * self.length);
        Row { shift: g, turn: reflected - n.cross(&arm) * tilt, across: g - n * tilt }
    }
}
