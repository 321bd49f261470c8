//! Poses in the user's frame, at the user's reference point.
//!
//! `T_user = T_tare^-1 * T_base * T_sensor * T_tool`. Errors of the angles move a point that is away from the
//! apex. The covariance is therefore transformed by the exact derivative of the pose, lever arm included.

use nalgebra::Matrix6;
use trifacet_optics::{Mat3, Pose, Rigid, Vec3};

/// Within a degree of a pitch of 90 degrees, roll and yaw cannot be separated: their standard uncertainties
/// are 57 times those of a rotation at that limit, and grow without bound beyond it. Cosine of 89 degrees.
const LEAST_COSINE: f64 = 0.017_452_406_437_283_5;

/// The transformation from the world frame of the head to the user's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frames {
    /// `T_tare^-1 * T_base`.
    outer: Rigid,
    tool: Rigid,
    /// No transformation: poses pass unchanged, bit by bit.
    plain: bool,
}

impl Default for Frames {
    fn default() -> Self {
        Self { outer: Rigid::identity(), tool: Rigid::identity(), plain: true }
    }
}

impl Frames {
    /// The transformation with a base, a tare and a tool.
    pub fn new(base: &Rigid, tare: &Rigid, tool: &Rigid) -> Self {
        Self { outer: tare.inverse() * *base, tool: *tool, plain: false }
    }

    /// The pose in the user's frame. `None` if its pitch is within a degree of 90 degrees, where roll and yaw
    /// are not defined separately.
    pub fn pose(&self, sensor: &Pose) -> Option<Pose> {
        if self.plain {
            return Some(*sensor);
        }
        let user = Pose::from(&(self.outer * Rigid::from(sensor) * self.tool));
        // Written so that a NaN is refused.
        let fine = user.pitch.cos() >= LEAST_COSINE && user.to_array().iter().all(|x| x.is_finite());
        fine.then_some(user)
    }

    /// The covariance of `user`, given the covariance of the pose `sensor` in the world frame of the head.
    pub fn covariance(&self, sensor: &Pose, user: &Pose, covariance: &Matrix6<f64>) -> Matrix6<f64> {
        if self.plain {
            return *covariance;
        }
        let slope = self.slope(sensor, user);
        slope * covariance * slope.transpose()
    }

    /// The pose `sensor` at which the pose in the user's frame is zero.
    pub fn zero(&self) -> Pose {
        Pose::from(&(self.outer.inverse() * self.tool.inverse()))
    }

    /// The covariance of `user`, given that of the shift of a point of the mirror and of the rotation in the world
    /// frame of the head. The user's pose is `sensor` there.
    pub fn of_point(&self, sensor: &Pose, user: &Pose, at: &Vec3, covariance: &Matrix6<f64>) -> Matrix6<f64> {
        let turn = self.outer.rotation;
        let arm = sensor.t + sensor.rotation() * self.tool.translation - at;
        let mut slope = Matrix6::zeros();
        slope.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        slope.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-turn * cross(&arm)));
        slope.fixed_view_mut::<3, 3>(3, 3).copy_from(&(user.euler_rates() * turn));
        slope * covariance * slope.transpose()
    }

    /// The derivative of the user's pose with respect to the sensor's: tx, ty, tz, roll, pitch, yaw each.
    fn slope(&self, sensor: &Pose, user: &Pose) -> Matrix6<f64> {
        let turn = self.outer.rotation;
        // From the angles of the sensor's pose to a small rotation in its world frame, and to the motion of
        // the tool.
        let axes = sensor.euler_axes();
        let arm = sensor.rotation() * self.tool.translation;
        let mut slope = Matrix6::zeros();
        slope.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        slope.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-turn * cross(&arm) * axes));
        slope.fixed_view_mut::<3, 3>(3, 3).copy_from(&(user.euler_rates() * turn * axes));
        slope
    }
}

/// `cross(a) * b` is a x b.
fn cross(a: &Vec3) -> Mat3 {
    a.cross_matrix()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix6, Vector6};
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    use super::*;

    /// A transformation from millimetres and degrees.
    fn rigid([x, y, z, roll, pitch, yaw]: [f64; 6]) -> Rigid {
        let [roll, pitch, yaw] = [roll, pitch, yaw].map(f64::to_radians);
        Rigid::from(&Pose { t: Vec3::new(x, y, z) / 1e3, roll, pitch, yaw })
    }

    fn frames(base: [f64; 6], tool: [f64; 6], tare: [f64; 6]) -> Frames {
        Frames::new(&rigid(base), &rigid(tare), &rigid(tool))
    }

    /// Up to half a metre, and any rotation.
    fn transform() -> impl Strategy<Value = [f64; 6]> {
        prop::array::uniform6(-1.0..1.0)
            .prop_map(|x: [f64; 6]| std::array::from_fn(|i| x[i] * if i < 3 { 500.0 } else { 180.0 }))
    }

    /// A few millimetres and a few degrees: more than the range of any sensor.
    fn sensor_pose() -> impl Strategy<Value = Pose> {
        prop::array::uniform6(-1.0..1.0).prop_map(|x: [f64; 6]| {
            Pose::from_array(std::array::from_fn(|i| x[i] * if i < 3 { 5e-3 } else { 0.1 }))
        })
    }

    /// The difference of two poses, with angles wrapped to the shorter way.
    fn difference(a: &Pose, b: &Pose) -> Vector6<f64> {
        let (a, b) = (a.to_array(), b.to_array());
        Vector6::from_fn(|i, _| {
            let d = a[i] - b[i];
            if i < 3 { d } else { d.sin().atan2(d.cos()) }
        })
    }

    proptest! {
        #[test]
        fn the_slope_is_the_derivative(
            base in transform(), tool in transform(), tare in transform(), pose in sensor_pose(),
        ) {
            const STEP: f64 = 1e-5;
            let frames = frames(base, tool, tare);
            let user = Pose::from(&(frames.outer * Rigid::from(&pose) * frames.tool));
            prop_assume!(user.pitch.cos() > 0.1);
            let slope = frames.slope(&pose, &user);
            for i in 0..6 {
                let moved = |by: f64| {
                    let mut array = pose.to_array();
                    array[i] += by;
                    frames.pose(&Pose::from_array(array)).unwrap()
                };
                let numeric = difference(&moved(STEP), &moved(-STEP)) / (2.0 * STEP);
                let error = (slope.column(i) - numeric).norm();
                prop_assert!(error < 1e-6, "{i}: {error} of {numeric}");
            }
        }

        #[test]
        fn a_tare_sets_its_pose_to_zero(base in transform(), tool in transform(), pose in sensor_pose()) {
            let before = Pose::from(&(frames(base, tool, [0.0; 6]).outer * Rigid::from(&pose)
                * frames(base, tool, [0.0; 6]).tool));
            prop_assume!(before.pitch.cos() > 0.1);
            let zero = Frames::new(&rigid(base), &Rigid::from(&before), &rigid(tool)).pose(&pose).unwrap();
            prop_assert!(zero.to_array().iter().all(|x| x.abs() < 1e-12), "{zero:?}");
        }
    }

    #[test]
    fn the_covariance_is_that_of_many_poses() {
        let frames = frames(
            [100.0, -50.0, 20.0, 30.0, -20.0, 75.0],
            [12.0, -8.0, -60.0, 5.0, 40.0, -10.0],
            [90.0, -40.0, 0.0, 10.0, 0.0, 60.0],
        );
        let pose = Pose::from_array([1e-4, -2e-4, 3e-4, 1e-3, -2e-3, 3e-3]);
        let mut random = rand_pcg::Pcg64::seed_from_u64(5);
        let mut draw = || Vector6::from_fn(|_, _| random.sample::<f64, _>(StandardNormal));
        // Correlated noise of micrometres and microradians, as in the sensor.
        let mix = Matrix6::from_fn(|i, k| {
            if i == k { 1e-6 * (1.0 + i as f64) } else { 1e-6 * ((i * 7 + k * 3) % 5) as f64 / 5.0 }
        });
        let user = frames.pose(&pose).unwrap();
        let stated = frames.covariance(&pose, &user, &(mix * mix.transpose()));
        let count = 100_000;
        let mut seen = Matrix6::zeros();
        for _ in 0..count {
            let noisy = Vector6::from(pose.to_array()) + mix * draw();
            let off = difference(&frames.pose(&Pose::from_array(noisy.into())).unwrap(), &user);
            seen += off * off.transpose() / f64::from(count);
        }
        for i in 0..6 {
            for k in 0..6 {
                let unit = (stated[(i, i)] * stated[(k, k)]).sqrt();
                let error = (seen[(i, k)] - stated[(i, k)]) / unit;
                assert!(error.abs() < 0.02, "{i} {k}: {error}"); // 4 sigma for this number of draws
            }
        }
    }

    #[test]
    fn a_point_on_an_arm_moves_with_the_angles_and_is_less_certain() {
        // A point 100 mm below the apex: a pitch of 1 mrad moves it by -0.1 mm along x.
        let frames = frames([0.0; 6], [0.0, 0.0, -100.0, 0.0, 0.0, 0.0], [0.0; 6]);
        let pose = Pose::from_array([0.0, 0.0, 0.0, 0.0, 1e-3, 0.0]);
        let user = frames.pose(&pose).unwrap();
        assert!((user.t.x + 0.1e-3).abs() < 1e-9 && (user.pitch - 1e-3).abs() < 1e-12, "{user:?}");
        let mut covariance = Matrix6::identity() * 1e-12;
        (covariance[(0, 4)], covariance[(4, 0)]) = (-0.45e-12, -0.45e-12);
        let arm = frames.covariance(&pose, &user, &covariance);
        let expected = 1e-12 * (1.0 + 0.1 * 0.1 + 2.0 * 0.1 * 0.45); // of t - 0.1 m * pitch
        assert!((arm[(0, 0)] / expected - 1.0).abs() < 1e-3, "{}", arm[(0, 0)]);
    }

    #[test]
    fn default_frames_change_nothing() {
        let pose = Pose::from_array([1e-4, -2e-4, 3e-4, 1e-3, -2e-3, 3e-3]);
        let covariance = Matrix6::from_fn(|i, k| 1e-12 / (1.0 + i as f64 + k as f64));
        let frames = frames([0.0; 6], [0.0; 6], [0.0; 6]);
        assert_eq!(frames.pose(&pose), Some(pose));
        assert_eq!(frames.covariance(&pose, &pose, &covariance), covariance);
    }

    #[test]
    fn a_pitch_near_90_degrees_is_refused_and_a_smaller_one_is_accepted() {
        let pose = Pose::default();
        for pitch in [89.5, 90.0, 90.5, -90.0, 270.0] {
            let frames = frames([0.0, 0.0, 0.0, 0.0, pitch, 0.0], [0.0; 6], [0.0; 6]);
            assert_eq!(frames.pose(&pose), None, "{pitch}");
        }
        for pitch in [88.9, -88.9, 91.5, 180.0] {
            let frames = frames([0.0, 0.0, 0.0, 0.0, pitch, 0.0], [0.0; 6], [0.0; 6]);
            assert!(frames.pose(&pose).is_some(), "{pitch}");
        }
        let frames = frames([1.0; 6], [0.0; 6], [0.0; 6]);
        assert_eq!(frames.pose(&Pose { roll: f64::NAN, ..pose }), None);
        assert_eq!(frames.pose(&Pose { t: Vec3::new(0.0, f64::INFINITY, 0.0), ..pose }), None);
    }
}
