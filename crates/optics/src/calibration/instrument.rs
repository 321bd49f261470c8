//! The forward model of a calibration: from the pose of the mirror to signals, with an elliptical beam.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

use super::point::Point;
use crate::beam::DARK;
use crate::model::{MIN_FACING, Optics};
use crate::ray::Ray;
use crate::{Ellipse, Head, Pose, Rigid, Vec3};

/// Pose (six), beam offset from the apex (two), logarithm of the total power.
pub(super) type State = SVector<f64, 9>;
/// u, v of A, B, C, and the logarithms of the three powers.
pub(super) type Nine = SVector<f64, 9>;
/// Pose in the frame of the reference (six), steering (two): computed minus measured.
pub(super) type Eight = SVector<f64, 8>;

/// A head on its stage.
#[derive(Clone, Debug)]
pub(super) struct Instrument {
    optics: Optics,
    ellipse: Ellipse,
    ln_gains: [f64; 3],
    steering_matrix: Matrix2<f64>,
    steering_origin: Vector2<f64>,
    /// Sensor's world to frame of the reference; table to mirror.
    frames: [Rigid; 2],
}

/// Steps of the state for difference quotients. The offset has the shortest length, that of the beam.
const STEPS: [f64; 9] = [1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 3e-8, 3e-8, 1e-4];
/// Newton's method ends when a step is below this, metres and radians.
const STILL: f64 = 1e-13;
/// Largest number of Newton steps: enough for an offset of four sigma of the beam.
const MAX_STEPS: usize = 40;

impl Instrument {
    pub fn new(
        head: &Head,
        ellipse: Ellipse,
        ln_gains: [f64; 3],
        steering: (Matrix2<f64>, Vector2<f64>),
        frames: [Rigid; 2],
    ) -> Self {
        let (steering_matrix, steering_origin) = steering;
        let optics = Optics::new(head);
        Self { optics, ellipse, ln_gains, steering_matrix, steering_origin, frames }
    }

    /// The signals of a state; `None` if a facet is dark or a PSD is missed. A spot may be beyond the edge.
    pub fn signals(&self, x: &State) -> Option<Nine> {
        let rotation = pose(x).rotation();
        let mirror = self.optics.mirror(Vec3::new(x[0], x[1], x[2]), &rotation);
        let offset = Vector2::new(x[6], x[7]);
        if !(x.iter().all(|x| x.is_finite()) && mirror.normals.iter().all(|n| n.z > MIN_FACING)) {
            return None;
        }
        let wedges = self.ellipse.wedges(&mirror.normals, offset / self.optics.sigma());
        let mut signals = Nine::zeros();
        for (i, wedge) in wedges.iter().enumerate() {
            if wedge.power <= DARK {
                return None;
            }
            let normal = mirror.normals[i];
            let arm = self.optics.arm(wedge, normal, offset);
            let ray = Ray::new(&self.optics.psds[i], normal, mirror.t + arm);
            if !ray.reaches() {
                return None;
            }
            [signals[2 * i], signals[2 * i + 1]] = ray.spot;
            signals[6 + i] = wedge.power.ln() + x[8] + self.ln_gains[i];
        }
        Some(signals)
    }

    /// Derivatives of the signals with respect to the state.
    pub fn slopes(&self, x: &State) -> Option<SMatrix<f64, 9, 9>> {
        let mut slopes = SMatrix::<f64, 9, 9>::zeros();
        for (i, step) in STEPS.into_iter().enumerate() {
            let at = |step: f64| {
                let mut x = *x;
                x[i] += step;
                self.signals(&x)
            };
            slopes.set_column(i, &((at(step)? - at(-step)?) / (2.0 * step)));
        }
        Some(slopes)
    }

    /// The state that gives these signals, by Newton's method from `start` or from a centred mirror.
    pub fn solve(&self, target: &Nine, start: Option<&State>) -> Option<State> {
        let warm = start.and_then(|start| self.newton(target, *start));
        warm.or_else(|| {
            let mut centred = State::zeros();
            centred[8] = (6..9).map(|i| target[i].exp()).sum::<f64>().ln();
            self.newton(target, centred)
        })
    }

    fn newton(&self, target: &Nine, mut x: State) -> Option<State> {
        let sigma = self.optics.sigma();
        for _ in 0..MAX_STEPS {
            let missing = target - self.signals(&x)?;
            let step = self.slopes(&x)?.lu().solve(&missing)?;
            let reach = step.fixed_rows::<2>(6).norm() / sigma;
            x += step / reach.max(1.0);
            if step.fixed_rows::<8>(0).norm() < STILL {
                return Some(x);
            }
        }
        // Rounding may keep the steps above the limit; a state that explains the signals is a solution.
        let missing = target - self.signals(&x)?;
        (missing.fixed_rows::<6>(0).norm() < 1e-12 && missing.fixed_rows::<3>(6).norm() < 1e-9).then_some(x)
    }

    /// What the reference and the steering's readback would measure, less what they measured (zero where
    /// they did not).
    pub fn errors(&self, x: &State, point: &Point) -> Eight {
        let [from_world, from_table] = self.frames;
        let pose = Pose::from(&(from_world * Rigid::from(&pose(x)) * from_table));
        let readback = point.steering.map_or(Vector2::zeros(), |s| Vector2::new(s[0].value, s[1].value));
        let beam = self.optics.across(Vec3::new(x[0], x[1], x[2])) + Vector2::new(x[6], x[7]);
        let steering = beam - self.steering_origin - self.steering_matrix * readback;
        let mut errors = Eight::zeros();
        for (i, value) in pose.to_array().into_iter().enumerate() {
            errors[i] = value - point.reference[i].map_or(0.0, |known| known.value);
        }
        [errors[6], errors[7]] = steering.into();
        errors
    }

    /// Derivatives of [`Instrument::errors`] with respect to the state.
    pub fn error_slopes(&self, x: &State, point: &Point) -> SMatrix<f64, 8, 9> {
        let mut slopes = SMatrix::<f64, 8, 9>::zeros();
        for (i, step) in STEPS.into_iter().enumerate() {
            let at = |step: f64| {
                let mut x = *x;
                x[i] += step;
                self.errors(&x, point)
            };
            slopes.set_column(i, &((at(step) - at(-step)) / (2.0 * step)));
        }
        slopes
    }

    /// Uncertainty of the beam position by the readback: covariance.
    pub fn readback_covariance(&self, point: &Point) -> Matrix2<f64> {
        let variances = point.steering.map_or([0.0; 2], |s| s.map(|axis| axis.deviation.powi(2)));
        let matrix = self.steering_matrix;
        matrix * Matrix2::from_diagonal(&variances.into()) * matrix.transpose()
    }

    /// The state of a pose in the frame of the reference, with the beam at `offset` from the apex.
    pub fn state(&self, pose: &Pose, offset: Vector2<f64>) -> State {
        let [from_world, from_table] = self.frames;
        let world = Pose::from(&(from_world.inverse() * Rigid::from(pose) * from_table.inverse()));
        let mut x = State::zeros();
        x.fixed_rows_mut::<6>(0).copy_from_slice(&world.to_array());
        x.fixed_rows_mut::<2>(6).copy_from(&offset);
        x
    }
}

fn pose(x: &State) -> Pose {
    Pose::from_array([x[0], x[1], x[2], x[3], x[4], x[5]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Model;
    use crate::model::on_plane;

    fn instrument(c: f64, s: f64) -> Instrument {
        let steering = (Matrix2::identity(), Vector2::zeros());
        Instrument::new(&Head::default(), Ellipse::new(c, s), [0.0; 3], steering, [Rigid::identity(); 2])
    }

    const STATE: [f64; 9] = [2e-4, -1e-4, 3e-4, 2e-3, -3e-3, 1e-3, 4e-5, -3e-5, 0.0];

    #[test]
    fn a_round_beam_gives_the_signals_of_the_product() {
        let x = State::from(STATE);
        let signals = instrument(0.0, 0.0).signals(&x).unwrap();
        let optics = Optics::new(&Head::default());
        let reading = optics.trace(Model::Gaussian, &pose(&x), Vector2::new(x[6], x[7])).unwrap();
        for i in 0..6 {
            assert!((signals[i] - reading.spots[i]).abs() < 1e-16);
        }
        for i in 0..3 {
            assert!((signals[6 + i] - reading.powers[i].ln()).abs() < 1e-14);
        }
    }

    /// Powers and spots of an elliptical beam by quadrature over the wedges, in polar coordinates about the
    /// apex. The spot of the light is that of a ray through its centroid.
    #[test]
    fn an_elliptical_beam_agrees_with_a_quadrature() {
        let (x, c, s) = (State::from(STATE), 0.2, -0.15);
        let round = instrument(0.0, 0.0);
        let mirror = round.optics.mirror(pose(&x).t, &pose(&x).rotation());
        let sigma = round.optics.sigma();
        let inverse = Ellipse::new(-c, -s).covariance() / sigma.powi(2);
        let offset = Vector2::new(x[6], x[7]);
        let edge = |i: usize| {
            let along = mirror.normals[(i + 1) % 3].cross(&mirror.normals[i]);
            (-along.y).atan2(-along.x) + std::f64::consts::PI
        };
        let signals = instrument(c, s).signals(&x).unwrap();
        for i in 0..3 {
            let (from, mut to) = (edge((i + 2) % 3), edge(i));
            if to < from {
                to += std::f64::consts::TAU;
            }
            let (mut power, mut moment) = (0.0, Vector2::zeros());
            let (n, m, reach) = (200, 1000, 9.0 * sigma);
            for a in 0..=n {
                let simpson =
                    |k: usize, n: usize| if k == 0 || k == n { 1.0 } else { 2.0 + 2.0 * (k % 2) as f64 };
                let phi = from + (to - from) * f64::from(a) / f64::from(n);
                let unit = Vector2::new(phi.cos(), phi.sin());
                for b in 0..=m {
                    let r = reach * f64::from(b) / f64::from(m);
                    let p = unit * r - offset;
                    let density = (-0.5 * p.dot(&(inverse * p))).exp() * r;
                    let weight = simpson(a as usize, n as usize) * simpson(b as usize, m as usize);
                    power += weight * density;
                    moment += unit * (r * weight * density);
                }
            }
            let centroid: Vector2<f64> = moment / power;
            let area = (to - from) / f64::from(n) * reach / f64::from(m) / 9.0;
            let power = power * area / (std::f64::consts::TAU * sigma.powi(2));
            assert!((power.ln() - signals[6 + i]).abs() < 1e-9, "{power} {}", signals[6 + i].exp());
            let normal = mirror.normals[i];
            let ray = Ray::new(&round.optics.psds[i], normal, mirror.t + on_plane(normal, centroid));
            for k in 0..2 {
                assert!((ray.spot[k] - signals[2 * i + k]).abs() < 1e-12, "{:?}", ray.spot);
            }
        }
    }

    #[test]
    fn a_solution_gives_the_state_of_the_signals() {
        for scale in [0.0, 1.0, 4.0] {
            let x = State::from(STATE) * scale;
            let ours = instrument(0.05, 0.02);
            let found = ours.solve(&ours.signals(&x).unwrap(), None).unwrap();
            assert!((found - x).norm() < 1e-11, "{scale}: {found} {x}");
        }
    }

    #[test]
    fn dark_facets_have_no_signals() {
        let mut x = State::from(STATE);
        x[6] = 5e-3;
        assert!(instrument(0.0, 0.0).signals(&x).is_none());
        x[6] = f64::NAN;
        assert!(instrument(0.0, 0.0).signals(&x).is_none());
    }

    #[test]
    fn the_frames_lead_there_and_back() {
        let mut ours = instrument(0.0, 0.0);
        let frame = |a| Rigid::from(&Pose::from_array(a));
        ours.frames = [frame([1e-3, 2e-3, 3e-3, 0.1, 0.2, 0.3]), frame([4e-3, -5e-3, 6e-3, -0.1, 0.3, 0.2])];
        let wanted = Pose::from_array([1e-3, 2e-3, -3e-3, 4e-3, 5e-3, -6e-3]);
        let x = ours.state(&wanted, Vector2::zeros());
        let point = Point {
            spots: [0.0; 6],
            spot_deviations: [1.0; 6],
            powers: [1.0; 3],
            power_deviations: [1.0; 3],
            reference: [None; 6],
            steering: None,
            run: None,
        };
        let found = ours.errors(&x, &point);
        for (found, wanted) in found.iter().zip(wanted.to_array()) {
            assert!((found - wanted).abs() < 1e-15);
        }
    }
}
