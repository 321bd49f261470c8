//! A beam that a mirror steers by tilting it: its axis always passes through one point, the pivot.
//!
//! The direction of the light follows from where the beam goes, so that a pose has no further unknown. With the apex at
//! `t` and the beam at `q` from it, in the plane through the apex across the nominal light, the direction from the pivot
//! `c` is `unit(t + q - c)`. For this direction everything is as for a parallel beam: `Parallel` is the head, seen
//! along the actual light.
//!
//! The solver finds the direction `l` by Newton's method in its two components. For a given direction, the solver of a
//! parallel beam gives the foot of the axis (the point of the axis next to the apex), and the direction must be that
//! from the pivot to the foot. The derivative uses one fact: light and mirror that rotate together about the apex leave
//! the powers as they are, and rotate the reflected rays with them.

use nalgebra::{Matrix2, UnitQuaternion};

use super::estimate::Target;
use super::forward::{Light, State};
use super::jacobian::{Linearised, Residual, Step};
use super::model::turn_from_z;
use super::{Estimator, FacetOffset, HeadError, Mat3, Optics, Pose, Solution, SolveError, Vec2, Vec3};

/// Smallest distance of the pivot above the apex, against the nominal light, metres.
pub const NEAREST_PIVOT: f64 = 0.05;
/// The direction of the light is found when the next step would be below this, radians. The pose then changes by less
/// than 1e-12 m and rad.
const AT_REST: f64 = 1e-12;
/// The same for the offset of the beam where a pose is known, metres.
const OFFSET_AT_REST: f64 = 1e-12;
/// Largest number of directions that are tried from one start. Three or four suffice.
const MAX_DIRECTIONS: u8 = 20;

/// A head with a tilted beam, as a parallel beam along the actual light sees it.
pub(super) struct Parallel {
    /// The head, for the actual direction of the light.
    pub optics: Optics,
    /// Frame of the actual light to the frame of the nominal light.
    turn: Mat3,
    /// Frame of the nominal light.
    pivot: Vec3,
}

impl Optics {
    /// The same head with a beam that comes from `pivot` (world frame, metres), instead of a beam that keeps the
    /// direction `beam_direction` of the head. Offsets of the beam are then where its axis crosses the plane through the
    /// apex across `beam_direction`.
    ///
    /// # Errors
    /// The pivot is not finite, or less than [`NEAREST_PIVOT`] above the apex.
    pub fn from_pivot(mut self, pivot: Vec3) -> Result<Self, HeadError> {
        let pivot = self.to_world.transpose() * pivot;
        let valid = pivot.iter().all(|x| x.is_finite()) && pivot.z >= NEAREST_PIVOT;
        if !valid {
            return Err(HeadError::Pivot { height: pivot.z });
        }
        self.pivot = Some(pivot);
        Ok(self)
    }

    /// The point from which the beam comes (world frame, metres); `None`: the beam keeps its direction.
    pub fn pivot(&self) -> Option<Vec3> {
        self.pivot.map(|pivot| self.to_world * pivot)
    }

    /// For a mirror with its apex at `t` (world frame) and a beam at `offset`: the head as a parallel beam sees it, and
    /// the offset across the actual light. `None` if the beam keeps its direction.
    pub(super) fn along_light(&self, t: Vec3, offset: Vec2) -> Option<(Parallel, Vec2)> {
        let pivot = self.pivot?;
        let parallel = self.toward(self.to_world.transpose() * t + offset.push(0.0) - pivot, pivot);
        let across = parallel.across(offset);
        Some((parallel, across))
    }

    /// What a tilted beam adds to the relation between apex, offset and beam position; `None`: nothing.
    pub(super) fn lean(&self, t: Vec3, offset: Vec2) -> Option<Lean> {
        let pivot = self.pivot?;
        let at = self.to_world.transpose() * t;
        let (way, height) = (at.xy() + offset - pivot.xy(), pivot.z - at.z);
        let scale = at.z / height;
        Some(Lean { shift: way * scale, scale, by_height: way * (pivot.z / (height * height)) })
    }

    /// As [`Optics::offset_of_powers`]. The powers depend so weakly on the direction of the light that it need not be
    /// differentiated: each step is at least 100 times smaller than the one before.
    pub(super) fn tilted_offset_of_powers(&self, powers: &[f64; 3], pose: &Pose) -> Result<Vec2, SolveError> {
        let mut offset = Vec2::zeros();
        for _ in 0..MAX_DIRECTIONS {
            let Some((parallel, _)) = self.along_light(pose.t, offset) else { break };
            let found = parallel.in_plane(parallel.optics.offset_of_powers(powers, pose)?);
            let step = (found - offset).norm();
            offset = found;
            if step < OFFSET_AT_REST {
                return Ok(offset);
            }
        }
        Err(SolveError::NotConverged { iterations: MAX_DIRECTIONS })
    }

    /// As [`Optics::facet_offset`]: Newton's method with numerical derivatives.
    pub(super) fn tilted_facet_offset(
        &self,
        facet: usize,
        spot: [f64; 2],
        pose: &Pose,
    ) -> Option<FacetOffset> {
        let unexplained = |offset: Vec2| {
            let (parallel, across) = self.along_light(pose.t, offset)?;
            let found = parallel.optics.facet_offset(facet, spot, pose)?;
            Some((found.offset - across, found.downhill))
        };
        let mut offset = Vec2::zeros();
        for _ in 0..MAX_DIRECTIONS {
            let (error, downhill) = unexplained(offset)?;
            if error.norm() < OFFSET_AT_REST {
                let downhill = downhill.try_normalize(0.0)?;
                return Some(FacetOffset { downhill, offset });
            }
            let unit = 1e-6;
            let slope = |axis: Vec2| Some((unexplained(offset + axis * unit)?.0 - error) / unit);
            let slopes = Matrix2::from_columns(&[slope(Vec2::x())?, slope(Vec2::y())?]);
            offset -= slopes.try_inverse()? * error;
        }
        None
    }

    /// The head, seen along light in this direction (frame of the nominal light, any length).
    fn toward(&self, light: Vec3, pivot: Vec3) -> Parallel {
        let turn = turn_from_z(-light.normalize());
        let into = turn.transpose();
        let mut optics = Self { to_world: self.to_world * turn, pivot: None, ..self.clone() };
        for psd in &mut optics.psds {
            for vector in [&mut psd.origin, &mut psd.x, &mut psd.y, &mut psd.z] {
                *vector = into * *vector;
            }
        }
        Parallel { optics, turn, pivot }
    }
}

/// From the plane through the apex to the plane of the apex at rest, a tilted beam moves across the nominal light.
pub(super) struct Lean {
    /// By this, metres.
    pub shift: Vec2,
    /// By this more, for each metre that it is further across.
    pub scale: f64,
    /// By this more, for each metre that the apex is higher.
    pub by_height: Vec2,
}

impl Parallel {
    /// The offset across the actual light, from the one in the plane across the nominal light.
    fn across(&self, offset: Vec2) -> Vec2 {
        (self.turn.transpose() * offset.push(0.0)).xy()
    }

    /// The offset in the plane across the nominal light, from the one across the actual light.
    pub fn in_plane(&self, across: Vec2) -> Vec2 {
        let (foot, light) = (self.turn * across.push(0.0), self.light());
        (foot - light * (foot.z / light.z)).xy()
    }

    /// The direction of the light, in the frame of the nominal light.
    fn light(&self) -> Vec3 {
        -self.turn.column(2)
    }

    /// A direction that differs by `change` across the light, in the frame of the nominal light.
    fn deflected(&self, change: Vec2) -> Vec3 {
        self.turn * change.push(-1.0)
    }

    /// From the pivot to the foot of the axis, in the frame of the actual light.
    fn ray(&self, state: &State) -> Vec3 {
        state.t + state.offset.push(0.0) - self.turn.transpose() * self.pivot
    }
}

/// How the solution follows a change of the direction of the light, in the frame of the actual light: for a change
/// along x, and along y.
struct Response([Step; 2]);

impl Response {
    fn new(optics: &Optics, light: &Light, equations: &Linearised) -> Self {
        Self([Vec2::x(), Vec2::y()].map(|change| {
            // The rotation that takes (0, 0, -1) to (change, -1).
            let turn = Vec3::new(change.y, -change.x, 0.0);
            let mut residual = Residual::default();
            for (i, (psd, reflection)) in optics.psds.iter().zip(&light.reflections).enumerate() {
                let swing = |axis| reflection.ray.swing(psd, axis, reflection.arm).dot(&turn);
                (residual.u[i], residual.v[i]) = (-swing(psd.y), -swing(psd.z));
            }
            let (dt, dw, doffset) = equations.solve(&residual);
            (dt, dw + turn, doffset)
        }))
    }

    /// The step with the response to a change of the light.
    fn add(&self, (t, w, offset): Step, change: Vec2) -> Step {
        let [x, y] = &self.0;
        (
            t + x.0 * change.x + y.0 * change.y,
            w + x.1 * change.x + y.1 * change.y,
            offset + x.2 * change.x + y.2 * change.y,
        )
    }

    /// The change of direction that is consistent with the pivot, if the foot moves by `foot` at a fixed direction, and
    /// the pivot is `distance` from it. `None` if none is.
    fn direction(&self, foot: Vec2, distance: f64) -> Option<Vec2> {
        let moved = self.0.map(|(t, _, offset)| t.xy() + offset);
        let equations = Matrix2::from_diagonal_element(distance) - Matrix2::from_columns(&moved);
        Some(equations.try_inverse()? * foot)
    }
}

/// How a solution follows a change of the signals if the light comes from a pivot.
pub(super) struct Follow {
    response: Response,
    distance: f64,
    /// Height of the crossing of the axis with the plane through the apex, along the light from the foot, metres.
    ahead: f64,
    /// Components across the actual light to those in the plane across the nominal light.
    into_plane: Option<Matrix2<f64>>,
}

impl Follow {
    /// At a solution, whose state and light are in the frame of the actual light.
    pub fn new(parallel: &Parallel, solution: &Solution, light: &Light, equations: &Linearised) -> Self {
        Self {
            response: Response::new(&parallel.optics, light, equations),
            distance: -parallel.ray(&solution.state).z,
            ahead: parallel.light().dot(&solution.offset.push(0.0)),
            into_plane: parallel.turn.transpose().fixed_view::<2, 2>(0, 0).into_owned().try_inverse(),
        }
    }

    /// The step of a parallel beam, with the change of the light that it causes. The offset of the result is the one in
    /// the plane across the nominal light.
    pub fn step(&self, step: Step) -> Option<Step> {
        let change = self.response.direction(step.0.xy() + step.2, self.distance)?;
        let (t, w, across) = self.response.add(step, change);
        Some((t, w, self.into_plane? * (across + change * self.ahead)))
    }
}

impl Estimator {
    /// The solution for a beam from `pivot` (frame of the nominal light).
    pub(super) fn solve_tilted(
        &self,
        target: &Target,
        warm: Option<&Solution>,
        pivot: Vec3,
    ) -> Result<Solution, SolveError> {
        if let Some(warm) = warm
            && let Some((parallel, _)) = self.optics().along_light(warm.pose.t, warm.offset)
            && let Ok(solution) = self.find_direction(target, parallel, Some(warm.clone()))
        {
            return Ok(solution);
        }
        self.find_direction(target, self.optics().toward(-pivot, pivot), None)
    }

    /// Newton's method for the direction of the light, from the one of `parallel`. The state of `start` is in its
    /// frame.
    fn find_direction(
        &self,
        target: &Target,
        mut parallel: Parallel,
        mut start: Option<Solution>,
    ) -> Result<Solution, SolveError> {
        let mut iterations: u8 = 0;
        for _ in 0..MAX_DIRECTIONS {
            let at = Self::new(parallel.optics.clone(), self.model());
            let mut solution = at.solve_target(target, start.as_ref())?;
            iterations = iterations.saturating_add(solution.iterations);
            let singular = SolveError::Singular { iterations };
            let ray = parallel.ray(&solution.state);
            let response = Response::new(
                &parallel.optics,
                &solution.light(&parallel.optics, self.model()),
                &solution.jacobian,
            );
            let change = response.direction(ray.xy(), -ray.z).ok_or(singular)?;
            if change.norm() < AT_REST {
                solution.offset = parallel.in_plane(solution.offset);
                solution.iterations = iterations;
                return Ok(solution);
            }
            if change.norm().is_nan() || change.norm() > 1.0 {
                return Err(SolveError::OutOfRange { iterations });
            }
            let next = self.optics().toward(parallel.deflected(change), parallel.pivot);
            solution.state = moved(&solution.state, response.add(<_>::default(), change), &parallel, &next);
            (parallel, start) = (next, Some(solution));
        }
        Err(SolveError::NotConverged { iterations })
    }
}

/// The state after a step, in the frame of another direction of the light.
fn moved(state: &State, (dt, dw, doffset): Step, from: &Parallel, to: &Parallel) -> State {
    let turn = nalgebra::Rotation3::from_matrix_unchecked(to.turn.transpose() * from.turn);
    State {
        t: turn * (state.t + dt),
        turn: UnitQuaternion::from_rotation_matrix(&turn) * UnitQuaternion::new(dw) * state.turn,
        offset: state.offset + doffset,
    }
}
