//! How the loop shall work: from the configuration, in SI units. All of it can change while it runs.

use trifacet_wire::actuator::LeaseAction;

use super::controller::Controller;
use super::lock::LockLimits;
use crate::config::{Config, LoopMode, OnExit, Target};
use crate::steering::{BeamMap, Xy};

/// A stage stands where it was sent after so many time constants.
const SETTLED: f64 = 5.0;
/// A stage that is this part of its range from where it was sent does not follow. So far a stage whose
/// readback is not calibrated may be off, and so far one that sticks leaps when it comes free.
const FOLLOWING: f64 = 0.05;

/// How the loop shall work.
#[derive(Clone, Copy, Debug)]
pub struct Tuning {
    pub(super) mode: LoopMode,
    pub(super) target: Target,
    /// The offset that the loop goes to, metres.
    pub(super) setpoint: Xy,
    pub(super) map: BeamMap,
    pub(super) controller: Controller,
    pub(super) limits: LockLimits,
    /// The stage moves with the apex.
    pub(super) feed_forward: bool,
    /// Bandwidth of the tracking filter.
    pub(super) tracking_hz: f64,
    /// From a sample to the effect of its command. A sample older than this comes too late: the gains are
    /// made for this delay, and with a longer one the loop would push again and again before it sees what
    /// it has done.
    pub(super) loop_delay_s: f64,
    /// After this time the samples show where the stage was sent.
    pub(super) settling_s: f64,
    /// For so long it may be on its way.
    pub(super) span_s: f64,
    /// How far from there it may be, metres.
    pub(super) following: f64,
    /// For how long samples may come too late, or the stage stay behind, until it is no hiccup.
    pub(super) patience_s: f64,
    pub(super) park: Xy,
    pub(super) on_exit: OnExit,
    pub(super) on_lease: LeaseAction,
    pub(super) lease_ms: u16,
}

impl Tuning {
    /// From a checked configuration.
    pub fn new(config: &Config) -> Self {
        let (steering, centering) = (&config.steering, &config.centering);
        let rate_hz = config.acquisition.rate_hz;
        let loop_delay_s = centering.loop_delay_s(rate_hz);
        let settling_s = loop_delay_s + SETTLED * centering.lag_ms * 1e-3 + 2.0 / rate_hz;
        Self {
            mode: centering.mode,
            target: centering.target,
            setpoint: centering.setpoint_um.map(|um| um * 1e-6),
            map: BeamMap::new(steering),
            controller: Controller::new(config),
            limits: LockLimits::new(centering),
            feed_forward: centering.feed_forward,
            tracking_hz: centering.tracking_hz(rate_hz),
            loop_delay_s,
            settling_s,
            span_s: loop_delay_s + settling_s,
            following: (centering.lock_limit_um + FOLLOWING * steering.limit_um) * 1e-6,
            patience_s: centering.lost_time_ms * 1e-3,
            park: steering.park_um.map(|um| um * 1e-6),
            on_exit: steering.on_exit,
            on_lease: match steering.on_lease {
                OnExit::Hold => LeaseAction::Hold,
                OnExit::Park => LeaseAction::Park,
            },
            lease_ms: steering.lease_ms,
        }
    }

    pub(super) fn lease_s(&self) -> f64 {
        f64::from(self.lease_ms) * 1e-3
    }
}
