//! Parameters of the loop, in SI units. All of them can change while the loop runs.

use trifacet_wire::actuator::LeaseAction;

use super::controller::Controller;
use super::lock::LockLimits;
use super::{LoopMode, OnExit, Target};
use crate::steering::{BeamMap, BeamOffset, StagePosition};

/// A step of the stage has settled after this many time constants: 0.7 % of the step remain.
const SETTLED: f64 = 5.0;
/// A stage that is farther from its command than this fraction of its range does not follow. The readback of
/// an uncalibrated stage may be off by this much, and a sticking stage may jump by this much when it comes
/// free.
const FOLLOWING: f64 = 0.05;

/// A command is late if it has no acknowledgement after this many loop delays.
const ANSWER_DELAYS: f64 = 4.0;

/// Parameters of the loop. The default suits a nominal head with a piezo stage, sampled at 1 kHz.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopParams {
    /// Mode of the loop.
    pub mode: LoopMode,
    /// The quantity that the loop brings to zero.
    pub target: Target,
    /// The beam offset that the loop regulates to, metres.
    pub setpoint: BeamOffset,
    /// Map from stage positions to beam positions.
    pub map: BeamMap,
    /// Gains and limits of the controller.
    pub controller: Controller,
    /// Conditions of the lock states.
    pub limits: LockLimits,
    /// Whether the command includes the tracked velocity of the apex (feed-forward).
    pub feed_forward: bool,
    /// Bandwidth of the tracking filter, hertz.
    pub tracking_hz: f64,
    /// Time from a sample to the effect of its command, seconds. The gains are computed for this delay; the
    /// loop does not act on older samples.
    pub loop_delay_s: f64,
    /// Time constant of the stage, seconds.
    pub lag_s: f64,
    /// Sampling period, seconds.
    pub period_s: f64,
    /// Parking position of the stage, metres.
    pub park: StagePosition,
    /// What the stage does when the daemon ends.
    pub on_exit: OnExit,
    /// What the stage does when the lease of the last command expires.
    pub on_lease: LeaseAction,
    /// Lease of a command, milliseconds.
    pub lease_ms: u16,
}

impl Default for LoopParams {
    fn default() -> Self {
        Self {
            mode: LoopMode::On,
            target: Target::Apex,
            setpoint: BeamOffset::default(),
            map: BeamMap::default(),
            controller: Controller::default(),
            limits: LockLimits::default(),
            feed_forward: true,
            tracking_hz: 1.0 / (std::f64::consts::TAU * 2.5e-3),
            loop_delay_s: 2.5e-3,
            lag_s: 0.5e-3,
            period_s: 1e-3,
            park: StagePosition::default(),
            on_exit: OnExit::Hold,
            on_lease: LeaseAction::Hold,
            lease_ms: 200,
        }
    }
}

impl LoopParams {
    pub(super) fn lease_s(&self) -> f64 {
        f64::from(self.lease_ms) * 1e-3
    }

    /// Time from a command until the samples show its full effect, seconds.
    pub(super) fn settling_s(&self) -> f64 {
        self.loop_delay_s + SETTLED * self.lag_s + 2.0 * self.period_s
    }

    /// Age up to which a command may still move the stage, seconds.
    pub(super) fn span_s(&self) -> f64 {
        self.loop_delay_s + self.settling_s()
    }

    /// Age at which a command without an acknowledgement is late, seconds. With the default gains, a loop is
    /// unstable if its delay is more than three times the configured one.
    pub(super) fn answer_s(&self) -> f64 {
        ANSWER_DELAYS * self.loop_delay_s + 2.0 * self.period_s
    }

    /// Largest distance between stage and command at which the stage counts as following, metres.
    pub(super) fn following(&self) -> f64 {
        self.limits.offset + FOLLOWING * self.controller.limit
    }
}
