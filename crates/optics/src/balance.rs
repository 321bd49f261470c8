//! The offset of the beam from the three powers alone.

use nalgebra::Matrix2;

use super::beam::{DARK, Split};
use super::estimate::total_power;
use super::{Optics, Pose, SolveError, Vec2};

/// Largest number of steps. Three or four suffice near the apex.
const MAX_STEPS: u8 = 20;
/// The iteration ends with a step below this fraction of the beam's sigma.
const AT_REST: f64 = 1e-9;

impl Optics {
    /// The offset of the beam centre from the apex (across the beam, metres) that explains the three powers,
    /// for a known orientation of the mirror. Linear in the offset, unlike the raw differences.
    ///
    /// # Errors
    /// A power is not finite or too small, the offset is out of range, or the iteration does not converge.
    pub fn offset_of_powers(&self, powers: &[f64; 3], pose: &Pose) -> Result<Vec2, SolveError> {
        if self.pivot.is_some() {
            return self.tilted_offset_of_powers(powers, pose);
        }
        let total = total_power(powers)?;
        let normals = self.mirror(pose.t, &pose.rotation()).normals;
        let mut d = Vec2::zeros();
        for iterations in 0..MAX_STEPS {
            let split = Split::new(&normals, d);
            let [a, b] = [split.wedge(0), split.wedge(1)];
            let jacobian = Matrix2::from_rows(&[a.moment.transpose(), b.moment.transpose()]);
            let inverse = jacobian.try_inverse().ok_or(SolveError::Singular { iterations })?;
            let mut step = inverse * Vec2::new(powers[0] / total - a.power, powers[1] / total - b.power);
            let size = step.norm();
            if size > 1.0 {
                step /= size;
            }
            d += step;
            if size < AT_REST {
                return Ok(d * self.sigma());
            }
            if [0, 1, 2].iter().any(|i| split.wedge(*i).power <= DARK) {
                return Err(SolveError::OutOfRange { iterations });
            }
        }
        Err(SolveError::NotConverged { iterations: MAX_STEPS })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Head, Model};

    #[test]
    fn the_offset_comes_back_to_a_picometre() {
        let head = Head::nominal(0.25, 0.013, std::f64::consts::FRAC_PI_4, 0.46e-3).unwrap();
        let optics = Optics::new(&head);
        let pose = Pose::from_array([1e-4, -2e-4, 0.0, 8e-3, -6e-3, 1e-2]);
        for k in 0..60 {
            let (r, angle) = (5e-6 * f64::from(k), f64::from(k));
            let offset = Vec2::new(r * angle.cos(), r * angle.sin());
            let (_, powers) = optics.trace_each(Model::Gaussian, &pose, offset);
            let found = optics.offset_of_powers(&powers, &pose).unwrap();
            // At 300 um a facet gets 1e-4 of the beam, and the rounding of the powers becomes visible.
            assert!((found - offset).norm() < 1e-12 + 1e-9 * r, "{k}");
        }
    }

    #[test]
    fn a_dark_facet_gives_a_reason() {
        let head = Head::nominal(0.25, 0.013, std::f64::consts::FRAC_PI_4, 0.46e-3).unwrap();
        let optics = Optics::new(&head);
        let refuse = |powers| optics.offset_of_powers(&powers, &Pose::default()).unwrap_err().to_string();
        assert!(refuse([0.5, 0.5, 0.0]).contains("PSD C"));
        assert!(refuse([0.5, f64::NAN, 0.5]).contains("PSD B"));
    }
}
