//! The PI controller in metres, with limits.
//!
//! Parameters and state are separate, so that new gains keep the state.

use crate::steering::{StageMove, StagePosition};

/// Gains and limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Controller {
    /// Proportional gain: metres of steering per metre of error.
    pub kp: f64,
    /// Integral gain: metres of steering per metre of error and second.
    pub ki_per_s: f64,
    /// Limit of the command on each axis, plus and minus, metres.
    pub limit: f64,
    /// Largest speed of the command on each axis, metres per second.
    pub slew: f64,
}

/// State of the controller: the last command and its error. There is no separate integrator. With new gains
/// or a new setpoint, the next command therefore continues from the last one without a jump.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ControllerState {
    /// The last command, metres.
    pub position: StagePosition,
    /// The error at that command; `None` just after the stage was taken over.
    error: Option<StageMove>,
}

impl ControllerState {
    /// The state of a stage at rest at `position`. Control starts there without a jump.
    pub fn at(position: StagePosition) -> Self {
        Self { position, error: None }
    }

    /// The same state, but with no axis farther from `at`, the actual position of the stage, than in
    /// `before`. The command thus waits for a stage that does not follow, and does not wind up.
    #[must_use]
    pub fn hold_if_stalled(self, before: &ControllerState, at: StagePosition) -> Self {
        let nearer = |i: usize| (self.position[i] - at[i]).abs() <= (before.position[i] - at[i]).abs();
        let position = [0, 1].map(|i| if nearer(i) { self.position[i] } else { before.position[i] });
        Self { position: StagePosition(position), ..self }
    }

    /// The same state for a setpoint that has moved by `step`.
    #[must_use]
    pub fn shifted(self, step: StageMove) -> Self {
        Self { error: self.error.map(|e| StageMove([e[0] + step[0], e[1] + step[1]])), ..self }
    }
}

/// Gains by the SIMC rule for a delay of 2.5 ms and a lag of 0.5 ms, for a stage with a range of plus and
/// minus 400 um. Source: S. Skogestad, "Simple analytic rules for model reduction and PID controller tuning",
/// J. Process Control 13 (2003) 291-309.
impl Default for Controller {
    fn default() -> Self {
        Self { kp: 0.1, ki_per_s: 200.0, limit: 400.0 * 1e-6, slew: 50.0 * 1e-3 }
    }
}

impl Controller {
    /// The next command, `dt` seconds after the last one. `error` is setpoint minus offset, in lengths of the
    /// stage. `velocity` is the feed-forward, metres per second: the velocity of the apex.
    ///
    /// The limits act on the sum of all parts, and the next step starts from the limited command, so that
    /// nothing winds up.
    #[must_use]
    pub fn update(
        &self,
        memory: &ControllerState,
        error: StageMove,
        velocity: StageMove,
        dt: f64,
    ) -> ControllerState {
        if !error.iter().chain(velocity.iter()).all(|x| x.is_finite()) {
            return self.hold(memory, dt); // not finite: do not move
        }
        let before = memory.error.unwrap_or(error);
        let mut next = ControllerState { position: memory.position, error: Some(error) };
        for (axis, error) in error.into_iter().enumerate() {
            let step = self.kp * (error - before[axis]) + (self.ki_per_s * error + velocity[axis]) * dt;
            next.position.0[axis] = self.rate_limit(memory.position[axis], memory.position[axis] + step, dt);
        }
        next
    }

    /// The next command without an error: the last command, or a step towards the limits if they have been
    /// reduced.
    #[must_use]
    pub fn hold(&self, memory: &ControllerState, dt: f64) -> ControllerState {
        self.go(memory, memory.position, dt)
    }

    /// The next command on the way to `target`, without feedback.
    #[must_use]
    pub fn go(&self, memory: &ControllerState, target: StagePosition, dt: f64) -> ControllerState {
        let position = [0, 1].map(|axis| self.rate_limit(memory.position[axis], target[axis], dt));
        ControllerState { position: StagePosition(position), error: None }
    }

    /// The nearest position within the limits.
    pub fn within(&self, position: StagePosition) -> StagePosition {
        StagePosition(position.map(|p| p.clamp(-self.limit, self.limit)))
    }

    /// The nearest position to `wanted` within the limits. A stage outside the limits returns at the slew
    /// limit.
    fn rate_limit(&self, from: f64, wanted: f64, dt: f64) -> f64 {
        let reach = self.slew * dt;
        let wanted = if wanted.is_finite() { wanted } else { from };
        wanted.clamp(-self.limit, self.limit).clamp(from - reach, from + reach)
    }

    /// Whether a command is at a limit.
    pub fn railed(&self, position: StagePosition) -> bool {
        position.iter().any(|p| p.abs() >= self.limit * (1.0 - 1e-9))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONTROLLER: Controller = Controller { kp: 0.1, ki_per_s: 200.0, limit: 400e-6, slew: 0.05 };
    const DT: f64 = 1e-3;
    const STILL: StageMove = StageMove([0.0; 2]);

    /// Controls a stage with a delay of two samples; the mirror is at `apex`.
    fn settle(controller: &Controller, apex: f64, steps: usize) -> Vec<ControllerState> {
        let mut run = vec![ControllerState::default(); 3];
        for k in 2..steps {
            let beam = run[k - 2].position[0];
            let memory = run[k];
            run.push(controller.update(&memory, StageMove([apex - beam, 0.0]), STILL, DT));
        }
        run
    }

    #[test]
    fn the_controller_brings_the_offset_to_zero_without_ringing() {
        let run = settle(&CONTROLLER, 100e-6, 200);
        let last = run.last().unwrap().position[0];
        assert!((last - 100e-6).abs() < 1e-9, "{last}");
        let most = run.iter().map(|m| m.position[0]).fold(0.0, f64::max);
        assert!(most < 110e-6, "{most}");
    }

    #[test]
    fn the_output_stays_within_limits_and_leaves_the_rail_at_once() {
        let run = settle(&CONTROLLER, 2e-3, 2000);
        assert!(run.iter().all(|m| m.position[0].abs() <= 400e-6));
        let railed = *run.last().unwrap();
        assert!(CONTROLLER.railed(railed.position));
        let next = CONTROLLER.update(&railed, StageMove([-10e-6, 0.0]), STILL, DT);
        assert!(next.position[0] < 400e-6, "no windup");
    }

    #[test]
    fn the_output_keeps_the_slew_limit() {
        let slow = Controller { slew: 1e-3, ..CONTROLLER };
        let run = settle(&slow, 300e-6, 1000);
        assert!(run.windows(2).all(|w| (w[1].position[0] - w[0].position[0]).abs() <= 1.0001e-6));
        assert!((run.last().unwrap().position[0] - 300e-6).abs() < 1e-9);
    }

    #[test]
    fn invalid_inputs_do_not_move_the_output() {
        let memory = ControllerState::at(StagePosition([1e-5, -2e-5]));
        for nonsense in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for error in [[nonsense, nonsense], [nonsense, 1e-6], [1e-6, nonsense]] {
                let next = CONTROLLER.update(&memory, StageMove(error), STILL, DT);
                assert_eq!(next.position, memory.position);
            }
        }
        let wild = Controller { kp: f64::MAX, ki_per_s: f64::MAX, ..CONTROLLER };
        let next = wild.update(
            &wild.update(&memory, StageMove([1.0; 2]), STILL, 1.0),
            StageMove([-1e300; 2]),
            STILL,
            DT,
        );
        assert!(next.position.iter().all(|p| p.abs() <= 400e-6), "{next:?}");
    }

    #[test]
    fn changes_of_gains_setpoint_or_limits_cause_no_jump() {
        let memory = CONTROLLER.update(
            &ControllerState::at(StagePosition([100e-6, 0.0])),
            StageMove([5e-6, 0.0]),
            STILL,
            DT,
        );
        let next = CONTROLLER.update(&memory, StageMove([5e-6, 0.0]), STILL, DT).position[0];
        // With three times the proportional gain the next step is the same, since the error has not changed.
        let retuned = Controller { kp: 0.3, ..CONTROLLER };
        assert_eq!(retuned.update(&memory, StageMove([5e-6, 0.0]), STILL, DT).position[0], next);
        // A setpoint 20 um away acts through the integral alone.
        let moved = CONTROLLER
            .update(&memory.shifted(StageMove([20e-6, 0.0])), StageMove([25e-6, 0.0]), STILL, DT)
            .position[0];
        assert!((moved - memory.position[0] - 0.2 * 25e-6).abs() < 1e-12, "{moved}");
        // Reduced limits are approached at the slew limit, with and without an error.
        let tight = Controller { limit: 20e-6, ..CONTROLLER };
        let mut memory = memory;
        for step in 0..3 {
            let blind = tight.hold(&memory, DT);
            let next =
                if step == 0 { blind } else { tight.update(&memory, StageMove([1e-3, 0.0]), STILL, DT) };
            assert!((memory.position[0] - next.position[0]) <= 50.001e-6, "{next:?}");
            memory = next;
        }
        assert_eq!(memory.position[0], 20e-6);
    }

    #[test]
    fn feed_forward_follows_the_apex_within_the_limits() {
        let memory = CONTROLLER.update(
            &ControllerState::at(StagePosition([10e-6, 0.0])),
            STILL,
            StageMove([2e-3, -5e-3]),
            DT,
        );
        assert!((memory.position[0] - 12e-6).abs() < 1e-12 && (memory.position[1] + 5e-6).abs() < 1e-12);
        let wild = CONTROLLER.update(&memory, STILL, StageMove([1e9, f64::NAN]), DT);
        assert_eq!(wild.position, memory.position);
        let fast = CONTROLLER.update(&memory, STILL, StageMove([1e9, 0.0]), DT);
        assert!((fast.position[0] - memory.position[0] - 50e-6).abs() < 1e-12, "at the slew limit");
    }

    #[test]
    fn the_controller_waits_for_a_lagging_stage() {
        let before = ControllerState::at(StagePosition([50e-6, 0.0]));
        let next = |error| {
            CONTROLLER.update(&before, error, STILL, DT).hold_if_stalled(&before, StagePosition([10e-6, 0.0]))
        };
        assert_eq!(next(StageMove([100e-6, 0.0])).position, before.position);
        assert!(next(StageMove([-100e-6, 0.0])).position[0] < 31e-6);
        assert_eq!(next(StageMove([0.0, 100e-6])).position, before.position);
    }

    #[test]
    fn a_target_is_approached_at_the_slew_limit_and_within_the_range() {
        let mut memory = ControllerState::at(StagePosition([0.0; 2]));
        let mut steps = 0;
        while memory.position != StagePosition([400e-6, -120e-6]) {
            let next = CONTROLLER.go(&memory, StagePosition([1e-3, -120e-6]), DT);
            assert!((0..2).all(|i| (next.position[i] - memory.position[i]).abs() <= 50.001e-6));
            (memory, steps) = (next, steps + 1);
        }
        assert_eq!(steps, 8);
    }

    #[test]
    fn taking_over_causes_no_proportional_step() {
        let next = CONTROLLER.update(
            &ControllerState::at(StagePosition([0.0; 2])),
            StageMove([100e-6, 0.0]),
            STILL,
            DT,
        );
        assert!((next.position[0] - 0.2 * 100e-6).abs() < 1e-12, "{next:?}");
    }
}
