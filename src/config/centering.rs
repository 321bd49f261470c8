//! `[centering]`: the control loop that keeps the beam on the apex.

use serde::{Deserialize, Serialize};
use trifacet_core::centering::{LoopMode, Target};

use super::check::{Checker, above_zero};

/// Shortest interval between the end of a self-check and the next one, seconds.
const SHORTEST_INTERVAL_S: f64 = 1.0;

/// Settings of `[centering]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CenteringConfig {
    /// Mode of the loop at the start.
    pub mode: LoopMode,
    /// Quantity that the loop controls to its setpoint.
    pub target: Target,
    /// Desired offset of the beam from the apex, x and y perpendicular to the beam, micrometres.
    pub setpoint_um: [f64; 2],
    /// Total delay from a sample to the effect of its command, milliseconds. It determines the default
    /// gains.
    pub loop_delay_ms: f64,
    /// First-order lag of the stage, milliseconds. It determines the default proportional gain.
    pub lag_ms: f64,
    /// Proportional gain. `None`: derived from the lag and the integral gain.
    pub kp: Option<f64>,
    /// Integral gain, per second. `None`: derived from the delay.
    pub ki_per_s: Option<f64>,
    /// Whether the stage follows the apex with its tracked velocity.
    pub feed_forward: bool,
    /// Bandwidth of the tracking filter, Hz. `None`: derived from the delay.
    pub tracking_hz: Option<f64>,
    /// Whether the loop searches for the apex if there is too little light.
    pub search: bool,
    /// Number of failed searches after which the loop holds, until light returns or the operator starts a
    /// search.
    pub search_attempts: u32,
    /// The loop is locked while the error and its rms stay within this limit, micrometres, ...
    pub lock_limit_um: f64,
    /// ... for this time, milliseconds.
    pub lock_time_ms: f64,
    /// Time without light after which the state `held` becomes `lost`, milliseconds.
    pub lost_time_ms: f64,
    /// Time from the end of a self-check to the next one, seconds; 0: only by command.
    pub self_check_s: f64,
}

/// Gains of the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// Proportional gain: metres of steering per metre of offset.
    pub kp: f64,
    /// Integral gain, per second.
    pub ki_per_s: f64,
}

impl Default for CenteringConfig {
    fn default() -> Self {
        Self {
            mode: LoopMode::On,
            target: Target::Apex,
            setpoint_um: [0.0; 2],
            loop_delay_ms: 2.5,
            lag_ms: 0.5,
            kp: None,
            ki_per_s: None,
            feed_forward: true,
            tracking_hz: None,
            search: true,
            search_attempts: 3,
            lock_limit_um: 3.0,
            lock_time_ms: 50.0,
            lost_time_ms: 50.0,
            self_check_s: 0.0,
        }
    }
}

impl CenteringConfig {
    /// The loop delay that the gains are derived from, seconds.
    ///
    /// A sampled loop has a delay of at least two periods, even if `loop_delay_ms` is less: one period
    /// until the next sample, half a period because the command is held in between, and the time for
    /// computation.
    pub fn loop_delay_s(&self, rate_hz: f64) -> f64 {
        (self.loop_delay_ms * 1e-3).max(2.0 / rate_hz)
    }

    /// The gains: those of the file, or by the SIMC rule `Ki = 1/(2 delay)` and `Kp = lag Ki`.
    ///
    /// Source: Skogestad 2003, "Simple analytic rules for model reduction and PID controller tuning", J.
    /// Process Control 13.
    pub fn gains(&self, rate_hz: f64) -> Gains {
        let ki_per_s = self.ki_per_s.unwrap_or(0.5 / self.loop_delay_s(rate_hz));
        Gains { kp: self.kp.unwrap_or(self.lag_ms * 1e-3 * ki_per_s), ki_per_s }
    }

    /// Bandwidth of the tracking filter, Hz: that of the file, or that of the loop, `1/(2 pi delay)`.
    ///
    /// The stage could not follow faster movements.
    pub fn tracking_hz(&self, rate_hz: f64) -> f64 {
        self.tracking_hz.unwrap_or(1.0 / (std::f64::consts::TAU * self.loop_delay_s(rate_hz)))
    }

    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.numbers("setpoint_um", &self.setpoint_um, -100.0..=100.0);
        at.number("loop_delay_ms", self.loop_delay_ms, above_zero(10_000.0));
        at.number("lag_ms", self.lag_ms, 0.0..=10_000.0);
        at.optional("kp", self.kp, 0.0..=10.0);
        at.optional("ki_per_s", self.ki_per_s, 0.0..=100_000.0);
        at.optional("tracking_hz", self.tracking_hz, 0.01..=10_000.0);
        at.number("search_attempts", self.search_attempts, 1.0..=1000.0);
        at.number("lock_limit_um", self.lock_limit_um, above_zero(1000.0));
        at.number("lock_time_ms", self.lock_time_ms, 0.0..=60_000.0);
        at.number("lost_time_ms", self.lost_time_ms, 0.0..=60_000.0);
        at.number("self_check_s", self.self_check_s, 0.0..=1e7);
        if self.self_check_s > 0.0 {
            at.number("self_check_s", self.self_check_s, SHORTEST_INTERVAL_S..=1e7);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_follow_from_the_delay_unless_they_are_given() {
        let config = CenteringConfig::default();
        let gains = config.gains(1000.0);
        assert!((gains.ki_per_s - 200.0).abs() < 1e-9 && (gains.kp - 0.1).abs() < 1e-12);
        // At 10 Hz, two sample periods determine the delay, so the gain must be lower.
        assert!((config.gains(10.0).ki_per_s - 2.5).abs() < 1e-12);
        let given = CenteringConfig { kp: Some(0.3), ki_per_s: Some(7.0), ..config };
        assert_eq!(given.gains(10.0), Gains { kp: 0.3, ki_per_s: 7.0 });
    }

    #[test]
    fn the_simc_rule_is_stable_everywhere() {
        for delay_ms in [0.01, 0.4, 2.5, 100.0, 10_000.0] {
            for lag_ms in [0.0, 0.5, 50.0, 10_000.0] {
                for rate_hz in [10.0, 1000.0, 20_000.0] {
                    let config = CenteringConfig { loop_delay_ms: delay_ms, lag_ms, ..Default::default() };
                    let (gains, delay_s) = (config.gains(rate_hz), config.loop_delay_s(rate_hz));
                    assert!(
                        trifacet_core::centering::stability::is_stable(
                            [gains.kp, gains.ki_per_s],
                            delay_s,
                            lag_ms * 1e-3,
                            1.0 / rate_hz
                        ),
                        "{delay_ms} {lag_ms} {rate_hz}"
                    );
                }
            }
        }
    }
}
