//! Six equations in six unknowns, as 3x3 blocks.

use nalgebra::{Matrix6, Vector6};

use super::{Mat3, Vec3};

/// Linear equations `[a b; c d] [x; y] = [r; s]`, factored.
///
/// With the rows ordered u | v and the columns tx ty wz | tz wx wy the blocks on the diagonal of a head
/// like the nominal one are well conditioned, so no pivoting is needed. Any other head gets a full
/// factorisation with pivoting.
#[derive(Clone, Copy, Debug)]
pub(super) enum Factored {
    Blocks { a_inv: Mat3, b: Mat3, c: Mat3, s_inv: Mat3 },
    Full { inverse: Matrix6<f64> },
}

/// A block whose determinant is smaller than this, relative to the product of its columns' lengths, is
/// not divided by.
const FLAT_BLOCK: f64 = 1e-3;
/// The same for all six equations: no pose can be told from these signals.
const SINGULAR: f64 = 1e-9;

impl Factored {
    /// `None` if the equations are singular or not finite.
    pub fn new(a: Mat3, b: Mat3, c: Mat3, d: Mat3) -> Option<Self> {
        Self::blocks(a, b, c, d).or_else(|| Self::full(a, b, c, d))
    }

    fn blocks(a: Mat3, b: Mat3, c: Mat3, d: Mat3) -> Option<Self> {
        let a_inv = inverse(&a)?;
        let s_inv = inverse(&(d - c * (a_inv * b)))?;
        Some(Self::Blocks { a_inv, b, c, s_inv })
    }

    fn full(a: Mat3, b: Mat3, c: Mat3, d: Mat3) -> Option<Self> {
        let mut m = Matrix6::zeros();
        for (at, block) in [((0, 0), a), ((0, 3), b), ((3, 0), c), ((3, 3), d)] {
            m.fixed_view_mut::<3, 3>(at.0, at.1).copy_from(&block);
        }
        let lu = m.full_piv_lu();
        let size: f64 = m.column_iter().map(|column| column.norm()).product();
        (lu.determinant().abs() > SINGULAR * size)
            .then(|| lu.try_inverse())?
            .map(|inverse| Self::Full { inverse })
    }

    /// The unknowns for a right-hand side.
    pub fn solve(&self, r: Vec3, s: Vec3) -> (Vec3, Vec3) {
        match self {
            Self::Blocks { a_inv, b, c, s_inv } => {
                let x = a_inv * r;
                let y = s_inv * (s - c * x);
                (x - a_inv * (b * y), y)
            }
            Self::Full { inverse } => {
                let x = inverse * Vector6::new(r.x, r.y, r.z, s.x, s.y, s.z);
                (x.fixed_rows::<3>(0).into(), x.fixed_rows::<3>(3).into())
            }
        }
    }
}

/// The inverse by cofactors; `None` if the matrix is nearly singular.
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
