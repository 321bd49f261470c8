//! The solver, from signals to pose: Newton's method on the ray model or the Gaussian model.
//!
//! The Gaussian model has nine equations (six coordinates, three powers) for nine unknowns (pose, beam
//! offset, total power). The total is the sum of the powers, since the fractions add up to one. The two
//! components of the offset are eliminated with two of the fractions. Six equations remain, as in the ray
//! model.
//!
//! All steps are taken in the beam frame, with the orientation as a quaternion.

use std::sync::Arc;

use nalgebra::{Quaternion, UnitQuaternion};
use serde::{Deserialize, Serialize};

use super::forward::{Light, State};
use super::jacobian::{Linearised, Residual};
use super::{FACETS, Model, Optics, Pose, Vec2, Vec3};

/// The six coordinates and three powers of one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signals {
    /// u, v of A, B, C in metres.
    pub spots: [f64; 6],
    /// Power on A, B, C in any unit; only their ratios matter. Not used by the ray model.
    pub powers: [f64; 3],
}

/// Reasons why there is no pose.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// A signal is not finite.
    #[error("the {signal} of PSD {psd} is not a finite number")]
    NotFinite {
        /// "spot" or "power".
        signal: &'static str,
        /// A, B or C.
        psd: char,
    },
    /// A spot is outside the sensitive area.
    #[error(
        "the spot is off PSD {psd}: u = {:.4} mm, v = {:.4} mm, allowed +-{:.4} mm",
        u * 1e3, v * 1e3, half_size * 1e3
    )]
    OffPsd {
        /// A, B or C.
        psd: char,
        /// First coordinate, metres.
        u: f64,
        /// Second coordinate, metres.
        v: f64,
        /// Largest allowed coordinate, metres.
        half_size: f64,
    },
    /// A power is zero, negative, or below [`FAINTEST`] of the sum.
    #[error("too little light on PSD {psd}: power {power:e}, required is more than {FAINTEST:e} of the sum")]
    Dark {
        /// A, B or C.
        psd: char,
        /// The measured power.
        power: f64,
    },
    /// The equations have no unique solution here.
    #[error("the equations are singular after {iterations} iterations")]
    Singular {
        /// Number of iterations.
        iterations: u8,
    },
    /// The steps do not converge.
    #[error("no convergence within {iterations} iterations")]
    NotConverged {
        /// Number of iterations.
        iterations: u8,
    },
    /// The steps lead to a state in which a facet gets no light or does not face the light.
    #[error("the solution leaves the range of the sensor after {iterations} iterations")]
    OutOfRange {
        /// Number of iterations.
        iterations: u8,
    },
}

impl SolveError {
    /// Number of iterations before the solver gave up; 0 if the signals were rejected at once.
    pub fn iterations(&self) -> u8 {
        match *self {
            Self::Singular { iterations }
            | Self::NotConverged { iterations }
            | Self::OutOfRange { iterations } => iterations,
            _ => 0,
        }
    }
}

/// A solved pose. Also the warm start of the next solve.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Solution {
    /// Position and orientation of the mirror.
    pub pose: Pose,
    /// Beam centre minus apex, across the nominal light, metres; zero by assumption with the ray model.
    pub offset: Vec2,
    /// Sum of the powers, in their unit; NaN with the ray model.
    pub total_power: f64,
    /// Number of Newton and chord steps.
    pub iterations: u8,
    /// In the frame of the actual light.
    pub(super) state: State,
    /// The linearised equations of the last step, possibly from an earlier sample.
    pub(super) jacobian: Arc<Linearised>,
    pub(super) fractions: Vec2,
}

impl Solution {
    /// The light of this solution.
    pub(super) fn light(&self, optics: &Optics, model: Model) -> Light {
        match model {
            Model::Ray => Light::new::<false>(optics, &self.state),
            Model::Gaussian => Light::new::<true>(optics, &self.state),
        }
    }
}

/// Target of the solver: spots, and the fractions on A and B.
pub(super) struct Target {
    spots: [f64; 6],
    fractions: Vec2,
    total: f64,
}

/// The iteration ends when the next step would be below this. The length of a step includes all components,
/// metres and radians alike.
const AT_REST: f64 = 1e-13;
/// The step after a Newton step is at most this times its square (1/m or 1/rad). The bound holds for heads of
/// about the nominal size, and is ten times the value observed on it.
const CURVATURE: f64 = 1e5;
/// After a larger step the equations are linearised again, because the next step would not be KEEP times
/// smaller.
const NEAR: f64 = 1e-5;
/// The equations are kept while each step is at most this fraction of the previous one.
const KEEP: f64 = 0.01;
/// Largest number of steps from one start: enough for an offset of four sigma of the beam.
const MAX_STEPS: u8 = 20;

/// The solver: turns signals into poses.
#[derive(Clone, Debug)]
pub struct Estimator {
    optics: Optics,
    model: Model,
}

impl Estimator {
    /// An estimator for this head and model.
    pub fn new(optics: Optics, model: Model) -> Self {
        Self { optics, model }
    }

    /// The optics of the head.
    pub fn optics(&self) -> &Optics {
        &self.optics
    }

    /// The model of the beam.
    pub fn model(&self) -> Model {
        self.model
    }

    /// The pose that explains the signals. The iteration starts from an earlier solution (fast if close) or
    /// from a centred mirror. If the warm start fails, the cold start is tried.
    ///
    /// # Errors
    /// The signals are not usable (not finite, off the PSD, dark), or the iteration does not converge.
    pub fn solve(&self, signals: &Signals, warm: Option<&Solution>) -> Result<Solution, SolveError> {
        let target = self.target(signals)?;
        match self.optics.pivot {
            None => self.solve_target(&target, warm),
            Some(pivot) => self.solve_tilted(&target, warm, pivot),
        }
    }

    /// The solution for a beam that keeps its direction.
    #[inline(always)]
    pub(super) fn solve_target(
        &self,
        target: &Target,
        warm: Option<&Solution>,
    ) -> Result<Solution, SolveError> {
        match self.model {
            Model::Ray => self.solve_for::<false>(target, warm),
            Model::Gaussian => self.solve_for::<true>(target, warm),
        }
    }

    /// The models are compiled separately, so that the ray model has no cost from the Gaussian model.
    #[inline(always)]
    fn solve_for<const GAUSSIAN: bool>(
        &self,
        target: &Target,
        warm: Option<&Solution>,
    ) -> Result<Solution, SolveError> {
        let mut iterations = 0;
        if let Some(warm) = warm {
            let kept = Some(Arc::clone(&warm.jacobian));
            let solution = self.iterate::<GAUSSIAN>(target, warm.state, kept, &mut iterations);
            if solution.is_ok() {
                return solution;
            }
        }
        self.iterate::<GAUSSIAN>(target, self.centred(), None, &mut iterations)
    }

    fn centred(&self) -> State {
        let turn = nalgebra::Rotation3::from_matrix_unchecked(self.optics.to_world.transpose());
        State { t: Vec3::zeros(), turn: UnitQuaternion::from_rotation_matrix(&turn), offset: Vec2::zeros() }
    }

    fn target(&self, signals: &Signals) -> Result<Target, SolveError> {
        for (i, psd) in FACETS.into_iter().enumerate() {
            let (u, v) = (signals.spots[2 * i], signals.spots[2 * i + 1]);
            let half_size = self.optics.psds[i].half_size;
            if !(u.is_finite() && v.is_finite()) {
                return Err(SolveError::NotFinite { signal: "spot", psd });
            }
            if u.abs() > half_size || v.abs() > half_size {
                return Err(SolveError::OffPsd { psd, u, v, half_size });
            }
        }
        let mut target = Target { spots: signals.spots, fractions: Vec2::zeros(), total: f64::NAN };
        if self.model == Model::Gaussian {
            target.total = total_power(&signals.powers)?;
            target.fractions = Vec2::new(signals.powers[0], signals.powers[1]) / target.total;
        }
        Ok(target)
    }

    /// Newton's method. The linearised equations are kept from step to step (and from sample to sample) as
    /// long as each step is much smaller than the previous one.
    fn iterate<const GAUSSIAN: bool>(
        &self,
        target: &Target,
        mut state: State,
        mut kept: Option<Arc<Linearised>>,
        count: &mut u8,
    ) -> Result<Solution, SolveError> {
        let mut last_step = f64::INFINITY;
        let limit = *count + MAX_STEPS;
        while *count < limit {
            let iterations = *count;
            let light = Light::new::<GAUSSIAN>(&self.optics, &state);
            if !light.valid {
                return Err(SolveError::OutOfRange { iterations });
            }
            let fresh = kept.is_none();
            let jacobian = match kept.take() {
                Some(jacobian) => jacobian,
                None => Linearised::new(&self.optics, &light)
                    .map(Arc::new)
                    .ok_or(SolveError::Singular { iterations })?,
            };
            let (step, limited) = self.step(&jacobian, &target.minus(&light), &mut state);
            *count += 1;
            let shrink = if last_step.is_finite() { step / last_step } else { KEEP };
            let next = step * if fresh { step * CURVATURE } else { shrink };
            if next < AT_REST && !limited {
                return Ok(self.solution(target, state, jacobian, *count));
            }
            let good = if fresh { step < NEAR } else { shrink <= KEEP && step < NEAR };
            kept = (good && !limited).then_some(jacobian);
            last_step = step;
        }
        Err(SolveError::NotConverged { iterations: *count })
    }

    /// Moves the state by the solution of the linear equations. Returns the length of the step (NaN if any
    /// part is NaN) and whether the step was shortened: the offset moves by at most one sigma of the beam.
    #[inline(always)]
    fn step(&self, jacobian: &Linearised, residual: &Residual, state: &mut State) -> (f64, bool) {
        let (dt, dw, doffset) = jacobian.solve(residual);
        let reach = doffset.norm() / self.optics.sigma;
        let scale = if reach > 1.0 { 1.0 / reach } else { 1.0 };
        state.t += dt * scale;
        // A rotation by dw, to third order; the quaternion is normalised again.
        let half = dw * (0.5 * scale);
        let turned = Quaternion::from_parts(1.0, half) * state.turn.into_inner();
        state.turn = UnitQuaternion::new_normalize(turned);
        state.offset += doffset * scale;
        ((dt.norm_squared() + dw.norm_squared() + doffset.norm_squared()).sqrt(), reach > 1.0)
    }

    #[inline(always)]
    fn solution(&self, target: &Target, state: State, jacobian: Arc<Linearised>, iterations: u8) -> Solution {
        let rotation = self.optics.to_world * state.turn.to_rotation_matrix().into_inner();
        Solution {
            pose: Pose::new(self.optics.to_world * state.t, &rotation),
            offset: state.offset,
            total_power: target.total,
            iterations,
            state,
            jacobian,
            fractions: target.fractions,
        }
    }
}

impl Target {
    /// Measured minus computed.
    #[inline(always)]
    fn minus(&self, light: &Light) -> Residual {
        let mut residual = Residual::default();
        for (i, reflection) in light.reflections.iter().enumerate() {
            residual.u[i] = self.spots[2 * i] - reflection.ray.spot[0];
            residual.v[i] = self.spots[2 * i + 1] - reflection.ray.spot[1];
            if let Some(wedge) = &reflection.wedge
                && i < 2
            {
                residual.fractions[i] = self.fractions[i] - wedge.power;
            }
        }
        residual
    }
}

/// A smaller fraction of the beam on one facet gives no usable offset: rounding of the powers alone (1e-16 of
/// the beam) would move the solution by more than 1e-10 m.
pub const FAINTEST: f64 = 1e-9;

/// A power above this counts as infinite: the sum of three would overflow.
const MAX_POWER: f64 = f64::MAX / 4.0;

/// The sum of the powers, if every PSD gets light.
pub(super) fn total_power(powers: &[f64; 3]) -> Result<f64, SolveError> {
    for (&power, psd) in powers.iter().zip(FACETS) {
        if power.is_nan() || power.abs() > MAX_POWER {
            return Err(SolveError::NotFinite { signal: "power", psd });
        }
    }
    let total: f64 = powers.iter().sum();
    for (&power, psd) in powers.iter().zip(FACETS) {
        if power <= 0.0 || power <= FAINTEST * total {
            return Err(SolveError::Dark { psd, power });
        }
    }
    Ok(total)
}
