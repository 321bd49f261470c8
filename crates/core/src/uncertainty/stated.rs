//! The covariance of poses relative to the tare by quantities with stated uncertainties, fast enough for every frame.

use nalgebra::{Matrix6, Vector6};
use trifacet_optics::quadratic::Quadratic;
use trifacet_optics::{Pose, Rigid, Vec3};

use super::{Effect, Instrument};

/// Steps of the quadratic function, metres and radians. The smaller ones are for a head that cannot reach the larger.
const STEPS: [[f64; 2]; 3] = [[1e-3, 5e-3], [0.25e-3, 1e-3], [0.05e-3, 0.2e-3]];
/// Elements of the lower triangle of a 6 x 6 matrix.
const TRIANGLE: usize = 21;

/// The covariance as a function of the pose. It is exact at the tare, and for effects in proportion to the pose.
#[derive(Clone, Debug)]
pub struct Stated {
    /// Lower triangle by rows, of tx, ty, tz (m), roll, pitch, yaw (rad) relative to the tare.
    covariance: Quadratic,
    /// The point of interest with its axes at the tare, in the sensor's world frame.
    zero: Rigid,
    /// The point of interest with its axes in the frame of the mirror.
    tool: Rigid,
}

impl Stated {
    /// The covariance by these standard uncertainties of independent quantities. `None` if the instrument cannot measure
    /// its tare pose and those around it.
    pub fn new(instrument: &Instrument, quantities: &[(f64, Effect)]) -> Option<Self> {
        let covariance = |pose: [f64; 6]| {
            let measurement = instrument.measure(&Pose::from_array(pose)).ok()?;
            let mut sum = Matrix6::zeros();
            for (std, effect) in quantities {
                let share = Vector6::from(measurement.slope(*effect, *std).ok()?) * *std;
                sum += share * share.transpose();
            }
            Some(triangle().map(|(i, k)| sum[(i, k)]).collect())
        };
        let covariance = STEPS.into_iter().find_map(|steps| Quadratic::new(steps, covariance))?;
        let usable = covariance.is_usable(TRIANGLE);
        usable.then(|| Self { covariance, zero: instrument.zero(), tool: instrument.tool() })
    }

    /// The point of interest (metres) with the mirror at a pose, and the covariance of its shift (m) and of the rotation
    /// (rad) relative to the tare. All in the sensor's world frame.
    pub fn at(&self, sensor: &Pose) -> (Vec3, Matrix6<f64>) {
        let tool = Rigid::from(sensor) * self.tool;
        let pose = Pose::from(&(self.zero.inverse() * tool));
        let mut values = [0.0; TRIANGLE];
        self.covariance.at(&pose.to_array(), &mut values);
        let mut covariance = Matrix6::zeros();
        for ((i, k), value) in triangle().zip(values) {
            (covariance[(i, k)], covariance[(k, i)]) = (value, value);
        }
        let mut turn = Matrix6::zeros();
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.zero.rotation);
        turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&(self.zero.rotation * pose.euler_axes()));
        (tool.translation, turn * covariance * turn.transpose())
    }
}

/// The places of the lower triangle, by rows.
fn triangle() -> impl Iterator<Item = (usize, usize)> {
    (0..6).flat_map(|i| (0..=i).map(move |k| (i, k)))
}
