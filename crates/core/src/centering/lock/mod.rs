//! The lock state machine: the lock state, its conditions, and the next action of the loop.
//!
//! ```text
//!                 light on all PSDs, from any state
//!        ┌──────────────────────────────────────────────────────┐
//!        v                                                      │
//!   regulating: acquiring <─> locked, railed ──(light is lost)──> holding: held, then lost
//!        ^                                                      │
//!        │            ┌──(some light)── jumping: acquiring <────┤ after one confirmation
//!        └────────────┤                   │ failed              │
//!                     └── searching <─────┴─────────────────────┘ after two
//!                            │ failed, `attempts` times
//!                            v
//!                         waiting: held
//! ```

mod cause;
mod condition;
#[cfg(test)]
mod tests;

pub use cause::LockCause;
pub use condition::{LockCondition, Transition};
use trifacet_wire::LockState;

use crate::centering::LoopMode;

/// Largest number of successive jumps towards the apex before a search begins.
const MOST_JUMPS: u32 = 8;
/// A PSD that is dark although the beam meets its facet is probably covered, for instance by a hand. A search
/// would lose the apex, so the loop waits this many times `lost_s` before it searches.
const COVERED: f64 = 20.0;
/// The loop gives up after the apex has been found and lost this many times without a lock. The steering
/// matrix is then probably wrong.
const MOST_SLIPS: u32 = 10;
/// The stage counts as off its limit after this fraction of the confirmation time.
const OFF_RAIL: f64 = 0.2;

/// In its rms, an error counts as at most this many times the limit, so that an approach from far away does
/// not delay the lock.
const FAR: f64 = 2.0;

/// Conditions for the states locked and lost, and for searches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LockLimits {
    /// Largest error, and largest rms of the error, for a lock, metres.
    pub offset: f64,
    /// Confirmation time: both must have been within the limit for this long, seconds.
    pub lock_s: f64,
    /// Time without light until the state is lost, seconds; after twice this time a search begins.
    pub lost_s: f64,
    /// Whether the loop may jump and search.
    pub search: bool,
    /// Number of searches before the loop waits.
    pub attempts: u32,
}

impl Default for LockLimits {
    fn default() -> Self {
        Self { offset: 3e-6, lock_s: 0.05, lost_s: 0.05, search: true, attempts: 3 }
    }
}

/// What a sample, or the lack of one, shows of the beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LockInput {
    /// All PSDs see light, and the error is known.
    Error {
        /// Size of the error, metres.
        size: f64,
        /// The actuator is at a limit.
        railed: bool,
    },
    /// One or two PSDs see light, or a channel is clipped.
    Partial {
        /// The apex is computed at another position, which the stage can reach.
        elsewhere: bool,
        /// The beam may be on the apex although light is missing: a PSD is covered, or a channel is clipped.
        covered: bool,
        /// The computed apex differs from the one at which the loop gave up.
        news: bool,
        /// The reason why the observation is incomplete.
        cause: LockCause,
    },
    /// No PSD sees light.
    Dark,
    /// The observation gives no information, for this reason.
    Unclear(LockCause),
}

/// Action of the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// The controller brings the error to zero.
    Regulating,
    /// The stage stays at its position.
    Holding,
    /// The stage moves straight to the computed position of the apex.
    Jumping,
    /// The stage moves along a spiral.
    Searching,
    /// The stage stays where the loop was last locked.
    Waiting,
}

/// Decision that follows from an observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LockDecision {
    /// The action from now on.
    pub action: Action,
    /// A jump or a search begins, perhaps for the second time.
    pub begins: bool,
    /// The change of the lock state, if there is one.
    pub transition: Option<Transition>,
}

/// The state machine.
#[derive(Clone, Debug)]
pub struct Lock {
    limits: LockLimits,
    state: LockState,
    /// Why the state is not another one.
    cause: LockCause,
    action: Action,
    /// Time with error and rms within the limits, seconds.
    good_s: f64,
    /// Time since the error was last known, seconds.
    blind_s: f64,
    mean_square: f64,
    /// No PSD saw light in the last sample.
    dark: bool,
    jumps: u32,
    /// Failed searches since the last lock.
    attempts: u32,
    /// A jump or a search has found light, and the loop has not locked since.
    found: bool,
    /// How many times the light was found and lost again since the last lock.
    slips: u32,
    /// Time since the stage left its limit, seconds.
    off_rail_s: f64,
}

/// The next state.
struct Next {
    action: Action,
    begins: bool,
    state: LockState,
    cause: LockCause,
}

impl Next {
    fn go_on(action: Action, state: LockState, cause: LockCause) -> Self {
        Self { action, begins: false, state, cause }
    }
}

impl Lock {
    /// The state machine of a loop in this mode.
    pub fn new(limits: LockLimits, mode: LoopMode) -> Self {
        let (state, action, cause) = match mode {
            LoopMode::On => (LockState::Acquiring, Action::Regulating, LockCause::SwitchedOn),
            LoopMode::Manual => (LockState::Manual, Action::Holding, LockCause::SwitchedToManual),
            LoopMode::Off | LoopMode::Shadow => (LockState::Off, Action::Holding, LockCause::SwitchedOff),
        };
        Self {
            limits,
            state,
            cause,
            action,
            good_s: 0.0,
            blind_s: 0.0,
            mean_square: f64::INFINITY,
            dark: false,
            jumps: 0,
            attempts: 0,
            found: false,
            slips: 0,
            off_rail_s: f64::INFINITY,
        }
    }

    /// Continues with other limits. A jump or search that they do not allow ends at once.
    pub fn retune(&mut self, limits: LockLimits) {
        self.limits = limits;
        if !limits.search && matches!(self.action, Action::Jumping | Action::Searching) {
            self.action = Action::Holding;
        }
    }

    /// Starts again in another mode.
    pub fn switch(&mut self, mode: LoopMode) -> Option<Transition> {
        let from = self.state;
        *self = Self::new(self.limits, mode);
        (from != self.state).then_some(Transition { from, to: self.state, cause: self.cause })
    }

    /// Starts a search on request of the operator: without the waiting time, and with all counts reset. Returns
    /// false if the loop regulates: then only the counts are reset.
    pub fn search(&mut self) -> bool {
        let starts = self.action != Action::Regulating;
        if starts {
            (self.action, self.blind_s) = (Action::Holding, f64::INFINITY);
        }
        (self.jumps, self.attempts, self.slips) = (0, 0, 0);
        starts
    }

    /// The state.
    pub fn state(&self) -> LockState {
        self.state
    }

    /// The cause of the present state.
    pub fn cause(&self) -> LockCause {
        self.cause
    }

    /// Failed searches since the last lock.
    pub fn attempts(&self) -> u32 {
        self.attempts
    }

    /// Takes an observation, `dt` seconds after the previous one. `arrived` is true when the jump or the
    /// search has ended.
    pub fn update(&mut self, seen: LockInput, arrived: bool, dt: f64) -> LockDecision {
        if matches!(self.state, LockState::Off | LockState::Manual) {
            return LockDecision { action: Action::Holding, begins: false, transition: None };
        }
        if self.action == Action::Regulating && !matches!(seen, LockInput::Error { .. }) {
            self.slips += u32::from(std::mem::take(&mut self.found));
        }
        let next = match seen {
            _ if self.slips >= MOST_SLIPS => Self::give_up(),
            LockInput::Error { size, railed } => self.regulate(size, railed, dt),
            LockInput::Partial { elsewhere, covered, news, cause } => {
                if news && self.action == Action::Waiting {
                    (self.action, self.attempts, self.jumps) = (Action::Holding, 0, 0);
                }
                self.some_light(elsewhere, covered, cause, arrived, dt)
            }
            LockInput::Dark => self.no_light(arrived, dt),
            LockInput::Unclear(cause) => self.hold(cause, dt),
        };
        self.dark = seen == LockInput::Dark;
        self.action = next.action;
        let from = std::mem::replace(&mut self.state, next.state);
        self.cause = next.cause;
        let transition =
            (from != next.state).then_some(Transition { from, to: next.state, cause: next.cause });
        LockDecision { action: next.action, begins: next.begins, transition }
    }

    fn regulate(&mut self, size: f64, railed: bool, dt: f64) -> Next {
        let found = matches!(self.action, Action::Jumping | Action::Searching);
        self.found |= found;
        (self.blind_s, self.jumps) = (0.0, 0);
        // Leaving and reaching a limit repeatedly is one event.
        self.off_rail_s = if railed { 0.0 } else { self.off_rail_s + dt };
        let railed = self.off_rail_s < OFF_RAIL * self.limits.lock_s || railed;
        let LockLimits { offset: limit, lock_s, .. } = self.limits;
        // Mean over about the confirmation time; the first sample after darkness starts it again.
        let fresh = !self.mean_square.is_finite();
        let weight = if fresh { 1.0 } else { dt / (lock_s + dt) };
        let before = if fresh { 0.0 } else { self.mean_square };
        let square = size.min(FAR * limit).powi(2);
        self.mean_square = before + weight * (square - before);
        // The comparisons are written so that NaN is outside.
        let within = size <= limit && self.mean_square.sqrt() <= limit;
        let (state, cause) = if found && !railed {
            (LockState::Acquiring, LockCause::LightFound)
        } else if railed {
            (LockState::Railed, LockCause::AtLimit)
        } else if !within {
            (LockState::Acquiring, LockCause::OffsetTooLarge)
        } else if self.state == LockState::Locked || self.good_s + dt >= lock_s {
            (self.attempts, self.slips, self.found) = (0, 0, false);
            (LockState::Locked, LockCause::OffsetWithinLimit)
        } else {
            (LockState::Acquiring, LockCause::Confirming)
        };
        self.good_s = if within && !railed { self.good_s + dt } else { 0.0 };
        Next::go_on(Action::Regulating, state, cause)
    }

    /// Holds the stage.
    fn hold(&mut self, cause: LockCause, dt: f64) -> Next {
        self.good_s = 0.0;
        self.mean_square = f64::INFINITY;
        self.blind_s += dt;
        if self.action == Action::Waiting {
            return Self::wait();
        }
        let lost = self.blind_s >= self.limits.lost_s;
        Next::go_on(Action::Holding, if lost { LockState::Lost } else { LockState::Held }, cause)
    }

    fn no_light(&mut self, arrived: bool, dt: f64) -> Next {
        const CAUSE: LockCause = LockCause::NoLight;
        match self.action {
            Action::Regulating | Action::Holding => {
                let held = self.hold(CAUSE, dt);
                if self.limits.search && self.blind_s >= 2.0 * self.limits.lost_s {
                    return Self::look(CAUSE);
                }
                held
            }
            Action::Jumping if arrived => Self::look(LockCause::NoLightAtApex),
            Action::Jumping => Self::capture(false),
            Action::Searching => self.look_on(arrived, CAUSE),
            Action::Waiting => Self::wait(),
        }
    }

    fn some_light(
        &mut self,
        elsewhere: bool,
        covered: bool,
        cause: LockCause,
        arrived: bool,
        dt: f64,
    ) -> Next {
        let leap = elsewhere && self.jumps < MOST_JUMPS;
        match self.action {
            Action::Regulating | Action::Holding => {
                let held = self.hold(cause, dt);
                let LockLimits { lost_s, search, .. } = self.limits;
                let patience = if covered { COVERED } else { 2.0 };
                match (search, leap) {
                    (true, true) if self.blind_s >= lost_s => self.leap(),
                    (true, false) if self.blind_s >= patience * lost_s => Self::look(cause),
                    _ => held,
                }
            }
            Action::Jumping if !arrived => Self::capture(false),
            Action::Jumping if leap => self.leap(),
            Action::Jumping => Self::look(LockCause::LittleLightAtApex),
            Action::Searching if self.dark && leap => self.leap(),
            Action::Searching => self.look_on(arrived, cause),
            Action::Waiting => Self::wait(),
        }
    }

    fn leap(&mut self) -> Next {
        self.jumps += 1;
        Self::capture(true)
    }

    fn capture(begins: bool) -> Next {
        let cause = LockCause::ApexSeen;
        Next { begins, ..Next::go_on(Action::Jumping, LockState::Acquiring, cause) }
    }

    fn look(cause: LockCause) -> Next {
        Next { begins: true, ..Next::go_on(Action::Searching, LockState::Searching, cause) }
    }

    fn look_on(&mut self, arrived: bool, cause: LockCause) -> Next {
        if !arrived {
            return Next::go_on(Action::Searching, LockState::Searching, cause);
        }
        (self.attempts, self.jumps) = (self.attempts + 1, 0);
        if self.attempts >= self.limits.attempts { Self::wait() } else { Self::look(cause) }
    }

    fn give_up() -> Next {
        let cause = LockCause::LostTooOften;
        Next::go_on(Action::Waiting, LockState::Held, cause)
    }

    fn wait() -> Next {
        let cause = LockCause::SearchesFailed;
        Next::go_on(Action::Waiting, LockState::Held, cause)
    }
}
