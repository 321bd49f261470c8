//! The sensor equations, linearised at a state.

use nalgebra::{Matrix2, Matrix2x3, Matrix3x2};
use serde::{Deserialize, Serialize};

use super::beam::{Wedge, WedgeSlopes};
use super::forward::Light;
use super::linear::Factored;
use super::ray::Row;
use super::{Mat3, Optics, Vec2, Vec3};

/// Measured minus computed: the u and the v of A, B, C, and the fractions on A and B.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Residual {
    pub u: Vec3,
    pub v: Vec3,
    pub fractions: Vec2,
}

/// A change of the unknowns, in the beam frame: translation, rotation, beam offset.
pub(super) type Step = (Vec3, Vec3, Vec2);

/// The linear equations, factored, for repeated right-hand sides.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Linearised {
    pose: Factored,
    offset: Option<OffsetEquations>,
}

/// The equations of the fractions on A and B for the beam offset, and the effect of the offset on the spots.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct OffsetEquations {
    /// Inverse of d(fractions)/d(offset).
    inverse: Matrix2<f64>,
    /// d(fractions)/d(rotation).
    by_turn: Matrix2x3<f64>,
    /// d(u)/d(offset) and d(v)/d(offset).
    spots: [Matrix3x2<f64>; 2],
}

/// d(u or v of A, B, C)/d(translation, rotation, offset).
#[derive(Default)]
struct Rows {
    shift: Mat3,
    turn: Mat3,
    offset: Matrix3x2<f64>,
}

/// Derivatives of the centroid of the light on a facet, across the beam.
struct Centroid {
    by_offset: Matrix2<f64>,
    by_turn: Matrix2x3<f64>,
}

impl Linearised {
    /// The linearised equations; `None` if they are singular.
    #[inline(always)]
    pub fn new(optics: &Optics, light: &Light) -> Option<Self> {
        let (mut u, mut v) = (Rows::default(), Rows::default());
        let (mut by_offset, mut by_turn) = (Matrix2::zeros(), Matrix2x3::zeros());
        for (i, (psd, reflection)) in optics.psds.iter().zip(&light.reflections).enumerate() {
            let mut centroid = None;
            if let (Some(split), Some(wedge)) = (&light.split, &reflection.wedge) {
                let jacobian = split.jacobian(i);
                centroid = Some(Centroid::new(wedge, &jacobian, optics.sigma()));
                if i < 2 {
                    by_offset.set_row(i, &(wedge.moment / optics.sigma()).transpose());
                    by_turn.set_row(i, &jacobian.power_turn.transpose());
                }
            }
            u.set(i, &reflection.ray.row(psd, psd.y, reflection.arm), centroid.as_ref());
            v.set(i, &reflection.ray.row(psd, psd.z, reflection.arm), centroid.as_ref());
        }
        let mut offset = None;
        if light.split.is_some() {
            let inverse = by_offset.try_inverse()?;
            u.eliminate(&inverse, &by_turn);
            v.eliminate(&inverse, &by_turn);
            offset = Some(OffsetEquations { inverse, by_turn, spots: [u.offset, v.offset] });
        }
        let pose = Factored::new(u.left(), u.right(), v.left(), v.right())?;
        Some(Self { pose, offset })
    }

    /// The step that brings the residual to zero.
    #[inline(always)]
    pub fn solve(&self, residual: &Residual) -> Step {
        let (mut u, mut v, mut offset) = (residual.u, residual.v, Vec2::zeros());
        if let Some(light) = &self.offset {
            offset = light.inverse * residual.fractions;
            u -= light.spots[0] * offset;
            v -= light.spots[1] * offset;
        }
        let (left, right) = self.pose.solve(u, v);
        let turn = Vec3::new(right.y, right.z, left.z);
        if let Some(light) = &self.offset {
            offset -= light.inverse * (light.by_turn * turn);
        }
        (Vec3::new(left.x, left.y, right.x), turn, offset)
    }
}

impl Rows {
    #[inline(always)]
    fn set(&mut self, facet: usize, row: &Row, centroid: Option<&Centroid>) {
        self.shift.set_row(facet, &row.shift.transpose());
        let mut turn = row.turn.transpose();
        if let Some(centroid) = centroid {
            let across = row.across.xy().transpose();
            turn += across * centroid.by_turn;
            self.offset.set_row(facet, &(across * centroid.by_offset));
        }
        self.turn.set_row(facet, &turn);
    }

    /// Eliminates the offset with the equations of the fractions.
    #[inline(always)]
    fn eliminate(&mut self, inverse: &Matrix2<f64>, by_turn: &Matrix2x3<f64>) {
        self.turn -= self.offset * (inverse * by_turn);
    }

    /// Columns tx, ty, rotation about z.
    fn left(&self) -> Mat3 {
        Mat3::from_columns(&[self.shift.column(0), self.shift.column(1), self.turn.column(2)])
    }

    /// Columns tz, rotation about x, rotation about y.
    fn right(&self) -> Mat3 {
        Mat3::from_columns(&[self.shift.column(2), self.turn.column(0), self.turn.column(1)])
    }
}

impl Centroid {
    #[inline(always)]
    fn new(wedge: &Wedge, jacobian: &WedgeSlopes, sigma: f64) -> Self {
        let per_power = 1.0 / wedge.power;
        let mean = wedge.moment * per_power;
        let by_offset = Matrix2::identity() + jacobian.moment_offset * per_power - mean * mean.transpose();
        let by_turn = (jacobian.moment_turn - mean * jacobian.power_turn.transpose()) * (sigma * per_power);
        Self { by_offset, by_turn }
    }
}
