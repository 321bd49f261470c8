//! `[centering]`: the loop that keeps the beam on the apex.

use serde::{Deserialize, Serialize};
use trifacet_core::centering::{LoopMode, Target};

use super::check::{Checker, above_zero};

/// `[centering]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CenteringConfig {
    /// What the loop does.
    pub mode: LoopMode,
    /// What the loop brings to zero.
    pub target: Target,
    /// To which offset of the beam the loop goes, x and y across the beam.
    pub setpoint_um: [f64; 2],
    /// From a sample to the effect of its command, everything included; sets the gains.
    pub loop_delay_ms: f64,
    /// First-order lag of the stage; sets the proportional gain.
    pub lag_ms: f64,
    /// Proportional gain, if not from the delay.
    pub kp: Option<f64>,
    /// Integral gain, if not from the delay.
    pub ki_per_s: Option<f64>,
    /// The stage moves with the apex, by its tracked velocity, and does not wait for an error.
    pub feed_forward: bool,
    /// Bandwidth of the tracking filter, if not from the delay.
    pub tracking_hz: Option<f64>,
    /// Without light, or with too little of it, the loop looks for the apex.
    pub search: bool,
    /// After so many searches in vain it holds, and waits for a person or for light.
    pub search_attempts: u32,
    /// Locked while offset and its rms stay within this.
    pub lock_limit_um: f64,
    /// ... for this long.
    pub lock_time_ms: f64,
    /// Held becomes lost after this long.
    pub lost_time_ms: f64,
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
        }
    }
}

impl CenteringConfig {
    /// The delay that the gains are made for, seconds.
    ///
    /// A sampled loop has a delay of two periods at least, whatever `loop_delay_ms` says: one until
    /// the next sample, half of one because the command stands still in between, and some to compute.
    pub fn loop_delay_s(&self, rate_hz: f64) -> f64 {
        (self.loop_delay_ms * 1e-3).max(2.0 / rate_hz)
    }

    /// The gains by the SIMC rule, `Ki = 1/(2 delay)` and `Kp = lag Ki`, unless the file sets them.
    pub fn gains(&self, rate_hz: f64) -> Gains {
        let ki_per_s = self.ki_per_s.unwrap_or(0.5 / self.loop_delay_s(rate_hz));
        Gains { kp: self.kp.unwrap_or(self.lag_ms * 1e-3 * ki_per_s), ki_per_s }
    }

    /// Bandwidth of the tracking filter: unless the file sets it, that of the loop, `1/(2 pi delay)`. What is
    /// faster the stage could not follow anyway.
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
        // At 10 Hz the sampling is the delay, and the loop must be slower.
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
