//! Reflection of one ray, from a point on a facet to the spot on its PSD, in the beam frame.

use super::{Psd, Vec3};

/// The reflection of one ray, and its intersection with the PSD.
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

/// Derivatives of one spot coordinate.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// With respect to a translation of the point of reflection.
    pub shift: Vec3,
    /// With respect to a rotation of the mirror about the apex, for a point on the facet that stays on the
    /// same line along the beam.
    pub turn: Vec3,
    /// With respect to a motion of that line across the beam (the z component is 0).
    pub across: Vec3,
}

impl Ray {
    /// Reflects the light at `point` on a facet with unit normal `normal`. The spot is meaningful only if the
    /// ray [reaches](Ray::reaches) the PSD.
    #[inline(always)]
    pub fn new(psd: &Psd, normal: Vec3, point: Vec3) -> Self {
        let (x, y, z) = (normal.x, normal.y, normal.z);
        let direction = Vec3::new(2.0 * z * x, 2.0 * z * y, 2.0 * z * z - 1.0);
        let toward = direction.dot(&psd.x);
        let from_psd = point - psd.origin;
        let length = -from_psd.dot(&psd.x) / toward;
        let hit = from_psd + direction * length;
        let spot = [hit.dot(&psd.y), hit.dot(&psd.z)];
        Self { normal, direction, length, toward, spot }
    }

    /// Whether the ray travels towards the PSD and meets its front side.
    pub fn reaches(&self) -> bool {
        self.toward < 0.0 && self.length > 0.0
    }

    /// The derivative of the coordinate along `axis` with respect to a rotation of this ray about the apex.
    pub fn swing(&self, psd: &Psd, axis: Vec3, arm: Vec3) -> Vec3 {
        let g = axis - psd.x * (self.direction.dot(&axis) / self.toward);
        (arm + self.direction * self.length).cross(&g)
    }

    /// The derivatives of the coordinate along `axis` (the y or z axis of the PSD). `arm` is the point of
    /// reflection relative to the apex.
    #[inline(always)]
    pub fn row(&self, psd: &Psd, axis: Vec3, arm: Vec3) -> Row {
        let n = self.normal;
        let g = axis - psd.x * (self.direction.dot(&axis) / self.toward);
        let tilt = g.z / n.z;
        // (g.n)(n x light) + (n.light)(n x g), written out, as the light has one component only.
        let (along, across) = (g.dot(&n), n.cross(&g) * n.z);
        let reflected = Vec3::new(-n.y * along - across.x, n.x * along - across.y, -across.z);
        let reflected = reflected * (-2.0 * self.length);
        Row { shift: g, turn: reflected - n.cross(&arm) * tilt, across: g - n * tilt }
    }
}
