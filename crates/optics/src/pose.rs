//! Position and orientation of the mirror.

use std::ops::Mul;

use serde::{Deserialize, Serialize};

use super::{Mat3, Vec3};

/// Position of the apex and orientation of the mirror, in the world frame.
///
/// `R = Rz(yaw) * Ry(pitch) * Rx(roll)`, Eq. 3 of the paper with alpha = yaw, beta = pitch, gamma = roll (the
/// sentence under Eq. 3 swaps roll and yaw; Table 2 is correct).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position of the apex, metres.
    pub t: Vec3,
    /// Rotation about x, gamma, radians.
    pub roll: f64,
    /// Rotation about y, beta, radians.
    pub pitch: f64,
    /// Rotation about z, alpha, radians.
    pub yaw: f64,
}

impl Pose {
    /// A pose from tx, ty, tz (m), roll, pitch, yaw (rad).
    pub fn from_array(a: [f64; 6]) -> Self {
        Self { t: Vec3::new(a[0], a[1], a[2]), roll: a[3], pitch: a[4], yaw: a[5] }
    }

    /// The values tx, ty, tz (m), roll, pitch, yaw (rad).
    pub fn to_array(self) -> [f64; 6] {
        [self.t.x, self.t.y, self.t.z, self.roll, self.pitch, self.yaw]
    }

    /// A pose from a position and a rotation matrix.
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

    /// Rates of roll, pitch, yaw for a small rotation of the mirror about the world axes: rows roll, pitch,
    /// yaw, columns x, y, z. Singular at a pitch of 90 degrees, far outside the range of the sensor.
    pub fn euler_rates(&self) -> Mat3 {
        let (sa, ca) = self.yaw.sin_cos();
        let (sb, cb) = self.pitch.sin_cos();
        let droll = Vec3::new(ca / cb, sa / cb, 0.0);
        let dyaw = Vec3::z() + droll * sb;
        Mat3::from_rows(&[droll.transpose(), Vec3::new(-sa, ca, 0.0).transpose(), dyaw.transpose()])
    }
    /// The axes of the rotations roll, pitch, yaw in the world frame, as columns. The inverse of
    /// [`Pose::euler_rates`], without its singularity.
    pub fn euler_axes(&self) -> Mat3 {
        let (sa, ca) = self.yaw.sin_cos();
        let (sb, cb) = self.pitch.sin_cos();
        Mat3::from_columns(&[Vec3::new(ca * cb, sa * cb, -sb), Vec3::new(-sa, ca, 0.0), Vec3::z()])
    }
}

/// A rigid transformation `x -> rotation * x + translation`: the pose of one frame in another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rigid {
    /// Axes of the frame, as columns.
    pub rotation: Mat3,
    /// Origin of the frame, metres.
    pub translation: Vec3,
}

impl Rigid {
    /// The identity.
    pub fn identity() -> Self {
        Self { rotation: Mat3::identity(), translation: Vec3::zeros() }
    }

    /// The inverse transformation.
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

/// Composition: `(a * b)(x) = a(b(x))`.
impl Mul for Rigid {
    type Output = Rigid;
    fn mul(self, inner: Rigid) -> Rigid {
        Rigid {
            rotation: self.rotation * inner.rotation,
            translation: self.rotation * inner.translation + self.translation,
        }
    }
}
