//! `[head]`: geometry of the sensor head.

use serde::{Deserialize, Serialize};
use trifacet_optics::{FACETS, Head, HeadError, Psd, Vec3};

use super::check::Checker;

/// Settings of `[head]`: four numbers define the nominal head; the other keys describe a calibrated head.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HeadConfig {
    /// Distance from the origin to each PSD, millimetres.
    pub psd_distance_mm: f64,
    /// Side of the sensitive area, millimetres.
    pub psd_size_mm: f64,
    /// Inclination of the facets to the base of the mirror, degrees.
    pub facet_angle_deg: f64,
    /// 1/e^2 diameter of the beam, millimetres.
    pub beam_diameter_mm: f64,
    /// Direction in which the light travels, world frame.
    pub beam_direction: Option<[f64; 3]>,
    /// Facet A and its PSD. `None`: nominal values.
    pub a: FacetConfig,
    /// Facet B and its PSD.
    pub b: FacetConfig,
    /// Facet C and its PSD.
    pub c: FacetConfig,
}

/// Settings of `[head.a]`, `[head.b]` or `[head.c]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FacetConfig {
    /// Normal of the facet in the mirror frame.
    pub normal: Option<[f64; 3]>,
    /// Centre of the PSD, world frame, millimetres.
    pub psd_origin_mm: Option<[f64; 3]>,
    /// Normal of the PSD, towards the mirror, world frame.
    pub psd_normal: Option<[f64; 3]>,
    /// Direction of the PSD's v-axis, world frame.
    pub psd_up: Option<[f64; 3]>,
}

impl Default for HeadConfig {
    fn default() -> Self {
        Self {
            psd_distance_mm: 250.0,
            psd_size_mm: 13.0,
            facet_angle_deg: 45.0,
            beam_diameter_mm: 0.46,
            beam_direction: None,
            a: FacetConfig::default(),
            b: FacetConfig::default(),
            c: FacetConfig::default(),
        }
    }
}

impl HeadConfig {
    /// The head in SI units: the nominal head, with the parts replaced that the file gives.
    ///
    /// # Errors
    /// Fails if the geometry does not describe a sensor head.
    pub fn build(&self) -> Result<Head, HeadError> {
        // Division by 1000 is exact if the result is a short decimal. Multiplication by 0.001 is not.
        let size = self.psd_size_mm / 1e3;
        let angle = self.facet_angle_deg.to_radians();
        let mut head = Head::nominal(self.psd_distance_mm / 1e3, size, angle, self.beam_diameter_mm / 1e3)?;
        for (i, part) in self.facets().into_iter().enumerate() {
            let nominal = head.psds[i];
            head.facets[i] = part.normal.map_or(head.facets[i], Vec3::from);
            head.psds[i] = Psd::facing(
                part.psd_origin_mm.map_or(nominal.origin, |mm| Vec3::from(mm) / 1e3),
                part.psd_normal.map_or(nominal.x, Vec3::from),
                part.psd_up.map_or(nominal.z, Vec3::from),
                size,
            );
        }
        if let Some(direction) = self.beam_direction {
            head.beam_direction = direction.into();
        }
        head.checked()
    }

    /// Settings of facets A, B and C, in this order.
    pub fn facets(&self) -> [&FacetConfig; 3] {
        [&self.a, &self.b, &self.c]
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("psd_distance_mm", self.psd_distance_mm, 5.0..=10_000.0);
        at.number("psd_size_mm", self.psd_size_mm, 0.5..=200.0);
        at.number("facet_angle_deg", self.facet_angle_deg, 5.0..=85.0);
        at.number("beam_diameter_mm", self.beam_diameter_mm, 0.01..=20.0);
        at.direction("beam_direction", self.beam_direction);
        for (name, facet) in FACETS.iter().zip(self.facets()) {
            facet.check(at.section(&name.to_lowercase().to_string()));
        }
    }
}

impl FacetConfig {
    fn check(&self, mut at: Checker<'_>) {
        at.direction("normal", self.normal);
        at.optional_numbers(
            "psd_origin_mm",
            self.psd_origin_mm.as_ref().map(|v| &v[..]),
            -10_000.0..=10_000.0,
        );
        at.direction("psd_normal", self.psd_normal);
        at.direction("psd_up", self.psd_up);
        if let (Some(x), Some(up)) = (self.psd_normal, self.psd_up) {
            let (x, up) = (Vec3::from(x), Vec3::from(up));
            let parallel = x.cross(&up).norm() <= 1e-6 * x.norm() * up.norm();
            at.agree(
                !parallel,
                "psd_up",
                &["psd_normal"],
                format!("{up:?}"),
                "a direction across psd_normal",
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_numbers_build_the_nominal_head() {
        let head = HeadConfig::default().build().unwrap();
        let nominal = Head::nominal(0.25, 0.013, std::f64::consts::FRAC_PI_4, 0.46e-3).unwrap();
        for (ours, theirs) in head.psds.iter().zip(&nominal.psds) {
            assert!((ours.origin - theirs.origin).norm() < 1e-15);
            assert!((ours.z - theirs.z).norm() < 1e-15);
            assert_eq!(ours.half_size, 0.0065);
        }
        for (ours, theirs) in head.facets.iter().zip(&nominal.facets) {
            assert!((ours - theirs).norm() < 1e-15);
        }
    }

    #[test]
    fn single_parts_replace_the_nominal_ones() {
        let mut config = HeadConfig::default();
        config.b.psd_origin_mm = Some([-120.0, 220.0, 5.0]);
        config.b.normal = Some([-1.0, 1.7, 2.0]);
        let head = config.build().unwrap();
        assert_eq!(head.psds[1].origin, Vec3::new(-0.12, 0.22, 0.005));
        assert!((head.facets[1].norm() - 1.0).abs() < 1e-15);
        assert!((head.facets[1] - Vec3::new(-1.0, 1.7, 2.0).normalize()).norm() < 1e-15);
        assert_eq!(head.psds[0].origin, Vec3::new(0.25, 0.0, 0.0));
    }
}
