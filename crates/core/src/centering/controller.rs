//! The controller: a PI controller in metres, with limits. Configuration and state are apart, so that
//! retuning keeps the state.

use crate::steering::Xy;

/// Gains and limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Controller {
    /// Metres of steering per metre of offset.
    pub kp: f64,
    /// The same per second.
    pub ki_per_s: f64,
    /// The command stays within plus and minus this, metres.
    pub limit: f64,
    /// The command moves at most so fast, metres per second.
    pub slew: f64,
}

/// What the controller remembers. There is no integral in it, only where the stage is and what was seen
/// there: so neither gains nor setpoint can change without the next command following from the last one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ControllerState {
    /// The last command, metres.
    pub position: Xy,
    /// The error at that command; none after taking over.
    error: Option<Xy>,
}

impl ControllerState {
    /// The state of a stage at rest at `position`: taking over there makes no jump.
    pub fn at(position: Xy) -> Self {
        Self { position, error: None }
    }

    /// The same state, but no axis farther from `at`, where the stage stands, than it is in `before`: a stage
    /// that stays behind is waited for, and nothing winds up that would send it far away once it comes free.
    #[must_use]
    pub fn hold_if_stalled(self, before: &ControllerState, at: Xy) -> Self {
        let nearer = |i: usize| (self.position[i] - at[i]).abs() <= (before.position[i] - at[i]).abs();
        let position = [0, 1].map(|i| if nearer(i) { self.position[i] } else { before.position[i] });
        Self { position, ..self }
    }

    /// The same state, for a setpoint that has moved by `step`.
    #[must_use]
    pub fn shifted(self, step: Xy) -> Self {
        Self { error: self.error.map(|e| [e[0] + step[0], e[1] + step[1]]), ..self }
    }
}

/// The SIMC rule for a delay of 2.5 ms and a lag of 0.5 ms, and a stage with a range of plus and minus 400 um.
impl Default for Controller {
    fn default() -> Self {
        Self { kp: 0.1, ki_per_s: 200.0, limit: 400.0 * 1e-6, slew: 50.0 * 1e-3 }
    }
}

impl Controller {
    /// The next command for an error (where the beam shall be, less where it is, in lengths of the stage),
    /// `dt` seconds after the last one. `velocity` is what the stage shall do anyway, metres per second: that
    /// of the apex, with feed-forward.
    ///
    /// The limits act on the sum of all parts, from which the next step goes on: nothing winds up.
    #[must_use]
    pub fn update(&self, memory: &ControllerState, error: Xy, velocity: Xy, dt: f64) -> ControllerState {
        if !error.iter().chain(&velocity).all(|x| x.is_finite()) {
            return self.hold(memory, dt); // no reason to move
        }
        let before = memory.error.unwrap_or(error);
        let mut next = ControllerState { position: memory.position, error: Some(error) };
        for (axis, error) in error.into_iter().enumerate() {
            let step = self.kp * (error - before[axis]) + (self.ki_per_s * error + velocity[axis]) * dt;
            next.position[axis] = self.rate_limit(memory.position[axis], memory.position[axis] + step, dt);
        }
        next
    }

    /// The next command when nothing is seen: the last one, or towards it if the limits have come closer.
    #[must_use]
    pub fn hold(&self, memory: &ControllerState, dt: f64) -> ControllerState {
        self.go(memory, memory.position, dt)
    }

    /// The next command on the way to `target`, whatever is seen.
    #[must_use]
    pub fn go(&self, memory: &ControllerState, target: Xy, dt: f64) -> ControllerState {
        let position = [0, 1].map(|axis| self.rate_limit(memory.position[axis], target[axis], dt));
        ControllerState { position, error: None }
    }

    /// As near to a position as the limits allow.
    pub fn within(&self, position: Xy) -> Xy {
        position.map(|p| p.clamp(-self.limit, self.limit))
    }

    /// As near to `wanted` as the limits allow. A stage outside of its limits goes back at its speed.
    fn rate_limit(&self, from: f64, wanted: f64, dt: f64) -> f64 {
        let reach = self.slew * dt;
        let wanted = if wanted.is_finite() { wanted } else { from };
        wanted.clamp(-self.limit, self.limit).clamp(from - reach, from + reach)
    }

    /// Whether a command stands at a limit.
    pub fn railed(&self, position: Xy) -> bool {
        position.iter().any(|p| p.abs() >= self.limit * (1.0 - 1e-9))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONTROLLER: Controller = Controller { kp: 0.1, ki_per_s: 200.0, limit: 400e-6, slew: 0.05 };
    const DT: f64 = 1e-3;
    const STILL: Xy = [0.0; 2];

    /// Steers a stage that follows after two samples; the mirror stands at `apex`.
    fn settle(controller: &Controller, apex: f64, steps: usize) -> Vec<ControllerState> {
        let mut run = vec![ControllerState::default(); 3];
        for k in 2..steps {
            let beam = run[k - 2].position[0];
            let memory = run[k];
            run.push(controller.update(&memory, [apex - beam, 0.0], STILL, DT));
        }
        run
    }

    #[test]
    fn it_brings_the_offset_to_zero_without_ringing() {
        let run = settle(&CONTROLLER, 100e-6, 200);
        let last = run.last().unwrap().position[0];
        assert!((last - 100e-6).abs() < 1e-9, "{last}");
        let most = run.iter().map(|m| m.position[0]).fold(0.0, f64::max);
        assert!(most < 110e-6, "{most}");
    }

    #[test]
    fn it_never_leaves_its_limits_and_leaves_the_rail_at_once() {
        let run = settle(&CONTROLLER, 2e-3, 2000);
        assert!(run.iter().all(|m| m.position[0].abs() <= 400e-6));
        let railed = *run.last().unwrap();
        assert!(CONTROLLER.railed(railed.position));
        let next = CONTROLLER.update(&railed, [-10e-6, 0.0], STILL, DT);
        assert!(next.position[0] < 400e-6, "no windup");
    }

    #[test]
    fn it_never_moves_faster_than_the_slew_limit() {
        let slow = Controller { slew: 1e-3, ..CONTROLLER };
        let run = settle(&slow, 300e-6, 1000);
        assert!(run.windows(2).all(|w| (w[1].position[0] - w[0].position[0]).abs() <= 1.0001e-6));
        assert!((run.last().unwrap().position[0] - 300e-6).abs() < 1e-9);
    }

    #[test]
    fn nonsense_does_not_move_it() {
        let memory = ControllerState::at([1e-5, -2e-5]);
        for nonsense in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for error in [[nonsense, nonsense], [nonsense, 1e-6], [1e-6, nonsense]] {
                let next = CONTROLLER.update(&memory, error, STILL, DT);
                assert_eq!(next.position, memory.position);
            }
        }
        let wild = Controller { kp: f64::MAX, ki_per_s: f64::MAX, ..CONTROLLER };
        let next = wild.update(&wild.update(&memory, [1.0; 2], STILL, 1.0), [-1e300; 2], STILL, DT);
        assert!(next.position.iter().all(|p| p.abs() <= 400e-6), "{next:?}");
    }

    #[test]
    fn no_change_of_gains_setpoint_or_limits_makes_it_jump() {
        let memory = CONTROLLER.update(&ControllerState::at([100e-6, 0.0]), [5e-6, 0.0], STILL, DT);
        let next = CONTROLLER.update(&memory, [5e-6, 0.0], STILL, DT).position[0];
        // Three times the proportional gain: the same next step, since the error has not moved.
        let retuned = Controller { kp: 0.3, ..CONTROLLER };
        assert_eq!(retuned.update(&memory, [5e-6, 0.0], STILL, DT).position[0], next);
        // A setpoint 20 um away moves it by the integral alone.
        let moved = CONTROLLER.update(&memory.shifted([20e-6, 0.0]), [25e-6, 0.0], STILL, DT).position[0];
        assert!((moved - memory.position[0] - 0.2 * 25e-6).abs() < 1e-12, "{moved}");
        // Limits that have come closer are reached at the slew limit, seeing or blind.
        let tight = Controller { limit: 20e-6, ..CONTROLLER };
        let mut memory = memory;
        for step in 0..3 {
            let blind = tight.hold(&memory, DT);
            let next = if step == 0 { blind } else { tight.update(&memory, [1e-3, 0.0], STILL, DT) };
            assert!((memory.position[0] - next.position[0]) <= 50.001e-6, "{next:?}");
            memory = next;
        }
        assert_eq!(memory.position[0], 20e-6);
    }

    #[test]
    fn feed_forward_goes_with_the_apex_within_the_limits() {
        let memory = CONTROLLER.update(&ControllerState::at([10e-6, 0.0]), STILL, [2e-3, -5e-3], DT);
        assert!((memory.position[0] - 12e-6).abs() < 1e-12 && (memory.position[1] + 5e-6).abs() < 1e-12);
        let wild = CONTROLLER.update(&memory, STILL, [1e9, f64::NAN], DT);
        assert_eq!(wild.position, memory.position);
        let fast = CONTROLLER.update(&memory, STILL, [1e9, 0.0], DT);
        assert!((fast.position[0] - memory.position[0] - 50e-6).abs() < 1e-12, "at the slew limit");
    }

    #[test]
    fn a_stage_that_stays_behind_is_waited_for_and_come_back_to() {
        let before = ControllerState::at([50e-6, 0.0]);
        let next =
            |error| CONTROLLER.update(&before, error, STILL, DT).hold_if_stalled(&before, [10e-6, 0.0]);
        assert_eq!(next([100e-6, 0.0]).position, before.position);
        assert!(next([-100e-6, 0.0]).position[0] < 31e-6);
        assert_eq!(next([0.0, 100e-6]).position, before.position);
    }

    #[test]
    fn a_target_is_gone_to_at_the_slew_limit_and_no_farther_than_the_range() {
        let mut memory = ControllerState::at([0.0; 2]);
        let mut steps = 0;
        while memory.position != [400e-6, -120e-6] {
            let next = CONTROLLER.go(&memory, [1e-3, -120e-6], DT);
            assert!((0..2).all(|i| (next.position[i] - memory.position[i]).abs() <= 50.001e-6));
            (memory, steps) = (next, steps + 1);
        }
        assert_eq!(steps, 8);
    }

    #[test]
    fn taking_over_makes_no_proportional_kick() {
        let next = CONTROLLER.update(&ControllerState::at([0.0; 2]), [100e-6, 0.0], STILL, DT);
        assert!((next.position[0] - 0.2 * 100e-6).abs() < 1e-12, "{next:?}");
    }
}
