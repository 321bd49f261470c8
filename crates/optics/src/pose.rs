//! Position and orientation.

use std::ops::Mul;

use serde::{Deserialize, Serialize};

use super::{Mat3, Vec3};

/// Where the apex is and how the mirror is turned, in the world frame.
///
/// `R = Rz(yaw) * Ry(pitch) * Rx(roll)`, Eq. 3 of the paper with alpha = yaw, beta = pitch,
/// gamma = roll (the sentence under Eq. 3 swaps roll and yaw; Table 2 has it right).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position of the apex, metres.
    pub t: Vec3,
    /// Turn about x, gamma, radians.
    pub roll: f64,
    /// Turn about y, beta, radians.
    pub pitch: f64,
    /// Turn about z, alpha, radians.
    pub yaw: f64,
}

impl Pose {
    /// From tx, ty, tz (m), roll, pitch, yaw (rad).
    pub fn from_array(a: [f64; 6]) -> Self {
        Self { t: Vec3::new(a[0], a[1], a[2]), roll: a[3], pitch: a[4], yaw: a[5] }
    }

    /// tx, ty, tz (m), roll, pitch, yaw (rad).
    pub fn to_array(self) -> [f64; 6] {
        [self.t.x, self.t.y, self.t.z, self.roll, self.pitch, self.yaw]
    }

    /// From a position and a rotation matrix.
    pub fn new(t: Vec3, r: &Mat3) -> Self {
        Self {
            t,
            roll: r[(2, 1)].atan2(r[(2, 2)]),
            pitch: -r[(2, 0)].clamp(-1.0, 1.0).asin(),
            yaw: r[(1, 0)].atan2(r[(0, 0)]),
        }
    }

    /// The rotation matrix of Eq. 3: mirror frame to world frame.
    pub fn rotation(&self) -> Mat3 {
        let (sa, ca) = self.yaw.sin_cos();
        let (sb, cb) = self.pitch.sin_cos();
        let (sg, cg) = self.roll.sin_cos();
        #[rustfmt::skip]
        let r = Mat3::new(
            ca * cb, ca * sb * sg - sa * cg, ca * sb * cg + sa * sg,
            sa * cb, sa * sb * sg + ca * cg, sa * sb * cg - ca * sg,
            -sb,     cb * sg,                cb * cg,
        );
        r
    }

    /// How roll, pitch, yaw change with a small turn of the mirror about the world axes:
    /// rows roll, pitch, yaw, columns x, y, z. Singular at a pitch of 90 degrees, far out of range.
    pub fn euler_rates(&self) -> Mat3 {
        let (sa, ca) = self.yaw.sin_cos();
        let (sb, cb) = self.pitch.sin_cos();
        let droll = Vec3::new(ca / cb, sa / cb, 0.0);
        let dyaw = Vec3::z() + droll * sb;
        Mat3::from_rows(&[droll.transpose(), Vec3::new(-sa, ca, 0.0).transpose(), dyaw.transpose()])
    }
    /// The axes about which roll, pitch, yaw turn the mirror, in the world: the columns. The inverse of
    /// [`Pose::euler_rates`], without its singularity.
    pub fn euler_axes(&self) -> Mat3 {
        let (sa, ca) = self.yaw.sin_cos();
        let (sb, cb) = self.pitch.sin_cos();
        Mat3::from_columns(&[Vec3::new(ca * cb, sa * cb, -sb), Vec3::new(-sa, ca, 0.0), Vec3::z()])
    }
}

/// A frame in another one, or the way from it: `x -> rotation * x + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// Its axes, as columns.
    pub rotation: Mat3,
    /// Its origin, metres.
    pub translation: Vec3,
}

impl Rigid {
    /// The frame itself.
    pub fn identity() -> Self {
        Self { rotation: Mat3::identity(), translation: Vec3::zeros() }
    }

    /// The way back.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }
}

impl From<&Pose> for Rigid {
    fn from(pose: &Pose) -> Self {
        Self { rotation: pose.rotation(), translation: pose.t }
    }
}

impl From<&Rigid> for Pose {
    fn from(rigid: &Rigid) -> Self {
        Pose::new(rigid.translation, &rigid.rotation)
    }
}

/// One after the other: `(a * b)(x) = a(b(x))`.
impl Mul for Rigid {
    type Output = Rigid;
    fn mul(self, inner: Rigid) -> Rigid {
        Rigid {
            rotation: self.rotation * inner.rotation,
            translation: self.rotation * inner.translation + self.translation,
        }
    }
}
