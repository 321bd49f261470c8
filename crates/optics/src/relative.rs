//! A pose relative to another one, with derivatives.

use nalgebra::Matrix6;

use super::{Mat3, Pose, Rigid};

/// The pose of one frame in another, and how it depends on both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relative {
    /// `zero^-1 * pose`.
    pub pose: Pose,
    /// Its derivative with respect to `pose`: rows and columns tx, ty, tz, roll, pitch, yaw.
    pub by_pose: Matrix6<f64>,
    /// Its derivative with respect to `zero`.
    pub by_zero: Matrix6<f64>,
}

impl Relative {
    /// `pose` in the frame of `zero`; both are poses in the same frame. The derivatives are singular where the
    /// result has a pitch of 90 degrees.
    pub fn new(pose: &Pose, zero: &Pose) -> Self {
        let back = zero.rotation().transpose();
        let relative = Pose::from(&(Rigid::from(zero).inverse() * Rigid::from(pose)));
        let way = pose.t - zero.t;
        let rates = relative.euler_rates() * back;
        Self {
            pose: relative,
            by_pose: matrix(&back, &Mat3::zeros(), &(rates * pose.euler_axes())),
            by_zero: matrix(
                &-back,
                &(back * way.cross_matrix() * zero.euler_axes()),
                &(-rates * zero.euler_axes()),
            ),
        }
    }
}

/// Translation by translation, translation by angles, angles by angles.
fn matrix(tt: &Mat3, ta: &Mat3, aa: &Mat3) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(tt);
    matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(ta);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(aa);
    matrix
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;
    use proptest::prelude::*;

    use super::*;

    fn pose() -> impl Strategy<Value = Pose> {
        prop::array::uniform6(-1.0..1.0).prop_map(|x: [f64; 6]| {
            Pose::from_array(std::array::from_fn(|i| x[i] * if i < 3 { 0.1 } else { 0.6 }))
        })
    }

    proptest! {
        #[test]
        fn both_derivatives_are_those_of_the_pose(pose in pose(), zero in pose()) {
            const STEP: f64 = 1e-6;
            let relative = Relative::new(&pose, &zero);
            prop_assume!(relative.pose.pitch.cos() > 0.3);
            let moved = |pose: &Pose, i: usize, by: f64| {
                let mut array = pose.to_array();
                array[i] += by;
                Pose::from_array(array)
            };
            let at = |pose: &Pose, zero: &Pose| Vector6::from(Relative::new(pose, zero).pose.to_array());
            for i in 0..6 {
                let [ahead, behind] = [STEP, -STEP].map(|by| at(&moved(&pose, i, by), &zero));
                let error = ((ahead - behind) / (2.0 * STEP) - relative.by_pose.column(i)).norm();
                prop_assert!(error < 1e-7, "{i}: {error}");
                let [ahead, behind] = [STEP, -STEP].map(|by| at(&pose, &moved(&zero, i, by)));
                let error = ((ahead - behind) / (2.0 * STEP) - relative.by_zero.column(i)).norm();
                prop_assert!(error < 1e-7, "{i}: {error}");
            }
        }

        #[test]
        fn a_pose_relative_to_itself_is_zero(pose in pose()) {
            let zero = Relative::new(&pose, &pose).pose;
            prop_assert!(zero.to_array().iter().all(|x| x.abs() < 1e-15));
        }
    }
}
