//! The controller: a PI controller in metres, with limits. Configuration and state are apart, so that
//! retuning keeps the state.

use crate::config::Config;

/// Two axes, metres.
pub type Xy = [f64; 2];

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

/// What the controller remembers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Memory {
    integral: Xy,
    /// The last command, metres.
    pub position: Xy,
}

impl Memory {
    /// The state of a stage at rest at `position`: taking over there makes no jump.
    pub fn at(position: Xy) -> Self {
        Self { integral: position, position }
    }
}

impl Controller {
    /// From a checked configuration.
    pub fn new(config: &Config) -> Self {
        let gains = config.centering.gains(config.acquisition.rate_hz);
        Self {
            kp: gains.kp,
            ki_per_s: gains.ki_per_s,
            limit: config.steering.limit_um * 1e-6,
            slew: config.steering.slew_mm_per_s * 1e-3,
        }
    }

    /// The next command for an offset of the beam, `dt` seconds after the last one.
    ///
    /// The integral is set back to what the limits let through, so that it never winds up.
    #[must_use]
    pub fn update(&self, memory: &Memory, offset: Xy, dt: f64) -> Memory {
        let mut next = *memory;
        if !offset.iter().all(|o| o.is_finite()) {
            return next; // no reason to move
        }
        for (axis, offset) in offset.into_iter().enumerate() {
            let error = -offset;
            let integral = memory.integral[axis] + self.ki_per_s * dt * error;
            let wanted = integral + self.kp * error;
            next.position[axis] = self.permitted(memory.position[axis], wanted, dt);
            next.integral[axis] = next.position[axis] - self.kp * error;
        }
        next
    }

    /// As near to `wanted` as the limits allow.
    fn permitted(&self, from: f64, wanted: f64, dt: f64) -> f64 {
        let reach = self.slew * dt;
        wanted.clamp(from - reach, from + reach).clamp(-self.limit, self.limit)
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

    /// Steers a stage that follows after two samples; the mirror stands at `apex`.
    fn settle(controller: &Controller, apex: f64, steps: usize) -> Vec<Memory> {
        let mut run = vec![Memory::default(); 3];
        for k in 2..steps {
            let beam = run[k - 2].position[0];
            let memory = run[k];
            run.push(controller.update(&memory, [beam - apex, 0.0], DT));
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
        let next = CONTROLLER.update(&railed, [10e-6, 0.0], DT);
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
        let memory = Memory::at([1e-5, -2e-5]);
        for nonsense in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let next = CONTROLLER.update(&memory, [nonsense, nonsense], DT);
            assert_eq!(next.position, memory.position);
        }
    }
}
