//! The steering stage of the laser: two axes that follow their commands with a delay and a lag, up to a
//! limit.

use std::collections::VecDeque;

/// An axis closer to a limit than this is at the limit, metres.
const AT_LIMIT: f64 = 1e-8;

/// A two-axis stage with a dead time, a first-order lag and mechanical limits.
///
/// Between commands each axis follows `x' = (target - x) / lag`, solved exactly, so that the result does not
/// depend on the times of the calls.
#[derive(Clone, Debug)]
pub struct StageSim {
    delay_s: f64,
    lag_s: f64,
    limit: f64,
    /// Position of the axes at `time_s`, metres.
    position: [f64; 2],
    target: [f64; 2],
    time_s: f64,
    /// Commands that do not act yet: start time in seconds, and target. Ordered by time.
    pending: VecDeque<(f64, [f64; 2])>,
}

impl StageSim {
    /// A stage at rest at its centre. Times in seconds, the limit in metres.
    pub fn new(delay_s: f64, lag_s: f64, limit: f64) -> Self {
        Self {
            delay_s,
            lag_s,
            limit,
            position: [0.0; 2],
            target: [0.0; 2],
            time_s: 0.0,
            pending: VecDeque::new(),
        }
    }

    /// A command given at `t_s`: move to `target` (metres). The command acts after the delay, and never
    /// before an earlier command.
    pub fn command(&mut self, target: [f64; 2], t_s: f64) {
        let last = self.pending.back().map_or(self.time_s, |(start, _)| *start);
        self.pending.push_back(((t_s + self.delay_s).max(last), target));
    }

    /// Advances to `t_s` (never back) and returns the position of the axes, metres. A stuck stage stays at
    /// its position, and follows its last command when it is free again.
    pub fn advance(&mut self, t_s: f64, stuck: bool) -> [f64; 2] {
        while let Some(&(start, target)) = self.pending.front()
            && start <= t_s
        {
            self.settle(start, stuck);
            self.target = target;
            self.pending.pop_front();
        }
        self.settle(t_s, stuck);
        self.position
    }

    /// Whether an axis is at its limit.
    pub fn railed(&self) -> bool {
        self.position.iter().any(|x| x.abs() >= self.limit - AT_LIMIT)
    }

    fn settle(&mut self, t_s: f64, stuck: bool) {
        let dt = (t_s - self.time_s).max(0.0);
        self.time_s = self.time_s.max(t_s);
        if stuck {
            return;
        }
        let left = if self.lag_s > 0.0 { (-dt / self.lag_s).exp() } else { 0.0 };
        for (x, target) in self.position.iter_mut().zip(self.target) {
            *x = (target + (*x - target) * left).clamp(-self.limit, self.limit);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_arrives_after_the_delay_with_the_lag() {
        let mut stage = StageSim::new(1e-3, 0.5e-3, 1e-3);
        stage.command([100e-6, -40e-6], 0.01);
        assert_eq!(stage.advance(0.011, false), [0.0; 2]);
        let after_one_lag = stage.advance(0.0115, false);
        let rise = 1.0 - (-1.0_f64).exp();
        assert!((after_one_lag[0] - 100e-6 * rise).abs() < 1e-15);
        assert!((after_one_lag[1] + 40e-6 * rise).abs() < 1e-15);
        assert!((stage.advance(0.03, false)[0] - 100e-6).abs() < 1e-12);
        assert!(!stage.railed());
    }

    #[test]
    fn the_path_does_not_depend_on_the_times_of_reading() {
        let run = |looks: u32| {
            let mut stage = StageSim::new(0.3e-3, 0.7e-3, 60e-6);
            stage.command([50e-6, 90e-6], 0.0);
            stage.command([-20e-6, 10e-6], 0.9e-3);
            (1..=looks).map(|k| stage.advance(2e-3 * f64::from(k) / f64::from(looks), false)).last().unwrap()
        };
        let (once, often) = (run(1), run(1000));
        assert!(once.iter().zip(often).all(|(a, b)| (a - b).abs() < 1e-16), "{once:?} {often:?}");
    }

    #[test]
    fn the_limit_is_kept_and_reported() {
        let mut stage = StageSim::new(0.0, 1e-3, 500e-6);
        stage.command([0.0, -700e-6], 0.0);
        assert_eq!(stage.advance(1.0, false), [0.0, -500e-6]);
        assert!(stage.railed());
        stage.command([0.0, -100e-6], 1.0);
        stage.advance(1.1, false);
        assert!(!stage.railed());
    }

    #[test]
    fn without_lag_the_stage_jumps_and_late_commands_act_at_once() {
        let mut stage = StageSim::new(0.0, 0.0, 1e-3);
        stage.advance(5.0, false);
        stage.command([1e-6, 2e-6], 4.0);
        assert_eq!(stage.advance(5.0, false), [1e-6, 2e-6]);
    }

    #[test]
    fn a_stuck_stage_stays_and_then_follows_the_last_command() {
        let mut stage = StageSim::new(0.0, 1e-4, 1e-3);
        stage.command([10e-6, 0.0], 0.0);
        stage.advance(1.0, false);
        stage.command([90e-6, 0.0], 1.0);
        assert!((stage.advance(2.0, true)[0] - 10e-6).abs() < 1e-15);
        assert!((stage.advance(3.0, false)[0] - 90e-6).abs() < 1e-15);
    }
}
