//! Six linear equations in six unknowns, as 3x3 blocks.

use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

use super::{Mat3, Vec3};

/// Linear equations `[a b; c d] [x; y] = [r; s]`, factored.
///
/// With the rows ordered u
/// v and the columns tx ty wz
/// tz wx wy, the diagonal blocks of a head like the nominal one are well conditioned, and no pivoting is
/// needed. Other heads get a full factorisation with pivoting.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Factored {
    a_inv: Mat3,
    b: Mat3,
    c: Mat3,
    /// Inverse of the Schur complement `d - c a^-1 b`.
    s_inv: Mat3,
    /// The inverse of the whole matrix, if the blocks are ill conditioned. Boxed: rare, and large.
    full: Option<Box<Matrix6<f64>>>,
}

/// A block is not inverted if its determinant is smaller than this, relative to the product of the lengths of
/// its columns.
const FLAT_BLOCK: f64 = 1e-3;
/// The same limit for all six equations: below it, these signals do not determine a pose.
const SINGULAR: f64 = 1e-9;

impl Factored {
    /// `None` if the equations are singular or not finite.
    #[inline(always)]
    pub fn new(a: Mat3, b: Mat3, c: Mat3, d: Mat3) -> Option<Self> {
        Self::blocks(a, b, c, d).or_else(|| Self::full(a, b, c, d))
    }

    #[inline(always)]
    fn blocks(a: Mat3, b: Mat3, c: Mat3, d: Mat3) -> Option<Self> {
        let a_inv = inverse(&a)?;
        let s_inv = inverse(&(d - c * (a_inv * b)))?;
        Some(Self { a_inv, b, c, s_inv, full: None })
    }

    #[cold]
    fn full(a: Mat3, b: Mat3, c: Mat3, d: Mat3) -> Option<Self> {
        let mut m = Matrix6::zeros();
        for (at, block) in [((0, 0), a), ((0, 3), b), ((3, 0), c), ((3, 3), d)] {
            m.fixed_view_mut::<3, 3>(at.0, at.1).copy_from(&block);
        }
        let lu = m.full_piv_lu();
        let size: f64 = m.column_iter().map(|column| column.norm()).product();
        let inverse = (lu.determinant().abs() > SINGULAR * size).then(|| lu.try_inverse()).flatten()?;
        Some(Self { a_inv: a, b, c, s_inv: d, full: Some(Box::new(inverse)) })
    }

    /// The unknowns for a right-hand side.
    #[inline(always)]
    pub fn solve(&self, r: Vec3, s: Vec3) -> (Vec3, Vec3) {
        if let Some(inverse) = &self.full {
            let x = **inverse * Vector6::new(r.x, r.y, r.z, s.x, s.y, s.z);
            return (x.fixed_rows::<3>(0).into(), x.fixed_rows::<3>(3).into());
        }
        let x = self.a_inv * r;
        let y = self.s_inv * (s - self.c * x);
        (x - self.a_inv * (self.b * y), y)
    }
}

/// The inverse by cofactors; `None` if the matrix is nearly singular.
#[inline(always)]
fn inverse(m: &Mat3) -> Option<Mat3> {
    let [x, y, z] = [0, 1, 2].map(|i| Vec3::from(m.column(i)));
    let yz = y.cross(&z);
    let determinant = x.dot(&yz);
    let size2 = x.norm_squared() * y.norm_squared() * z.norm_squared();
    let invertible = determinant * determinant > FLAT_BLOCK * FLAT_BLOCK * size2; // false for a NaN
    let (zx, xy) = (z.cross(&x), x.cross(&y));
    let cofactors = Mat3::new(yz.x, yz.y, yz.z, zx.x, zx.y, zx.z, xy.x, xy.y, xy.z);
    invertible.then(|| cofactors * (1.0 / determinant))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Error of the solution for a known vector of unknowns.
    fn off(a: Mat3, b: Mat3, c: Mat3, d: Mat3) -> f64 {
        let (x, y) = (Vec3::new(1.0, -2.0, 3.0), Vec3::new(-0.5, 0.25, 4.0));
        let (p, q) = Factored::new(a, b, c, d).unwrap().solve(a * x + b * y, c * x + d * y);
        (p - x).norm() + (q - y).norm()
    }

    #[test]
    fn blocks_and_full_pivoting_solve_the_same_equations() {
        let one = Mat3::identity();
        let some = Mat3::new(0.1, 0.2, -0.3, 0.0, 0.4, 0.1, -0.2, 0.5, 0.3);
        assert!(Factored::new(one, some, some, one).unwrap().full.is_none());
        assert!(off(one, some, some, one) < 1e-14);
        // The diagonal blocks are singular, the whole matrix is not.
        assert!(Factored::new(some * 0.0, one, one, some).unwrap().full.is_some());
        assert!(off(some * 0.0, one, one, some) < 1e-14);
    }

    #[test]
    fn singular_and_infinite_equations_are_refused() {
        let one = Mat3::identity();
        assert!(Factored::new(one, one, one, one).is_none());
        assert!(Factored::new(one * f64::NAN, one, one, one).is_none());
        assert!(Factored::new(one, one * f64::INFINITY, one, one).is_none());
    }
}
