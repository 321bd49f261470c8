//! The lock state: what the loop may claim, the conditions under which it may, and what it does next.
//!
//! ```text
//!                 light on all PSDs, whatever was before
//!        ┌──────────────────────────────────────────────────────┐
//!        v                                                      │
//!   regulating: acquiring <─> locked, railed ──(light is gone)──> holding: held, then lost
//!        ^                                                      │
//!        │            ┌──(some light)── jumping: acquiring <────┤ after one confirmation
//!        └────────────┤                   │ in vain             │
//!                     └── searching <─────┴─────────────────────┘ after two
//!                            │ in vain, so many times
//!                            v
//!                         waiting: held
//! ```

#[cfg(test)]
mod tests;

use trifacet_wire::LockState;

use crate::centering::LoopMode;

/// The most jumps in a row towards the apex before it is looked for instead.
const MOST_JUMPS: u32 = 8;
/// A PSD that is dark although the beam meets its facet is covered, most likely by a hand: looking elsewhere
/// would lose what is there, so it has that many times the patience.
const COVERED: f64 = 20.0;
/// An apex that is found and lost again so many times in a row, without a lock, will not be locked to: most
/// likely the stage moves the beam another way than is thought.
const MOST_SLIPS: u32 = 10;
/// The stage is off its limit when it has been for this part of the confirmation time.
const OFF_RAIL: f64 = 0.2;

/// In its rms an offset counts as at most so many times the limit: one that comes from afar is not held
/// against the loop for ever.
const FAR: f64 = 2.0;

/// When the loop may call itself locked, and when it must call itself lost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LockLimits {
    /// Largest offset, and largest rms of it, metres.
    pub offset: f64,
    /// How long they must have been within limits, seconds.
    pub lock_s: f64,
    /// How long the light may be gone before it counts as lost, seconds; twice as long, and a search begins.
    pub lost_s: f64,
    /// Whether it may look for the light.
    pub search: bool,
    /// How often, before it waits.
    pub attempts: u32,
}

impl Default for LockLimits {
    fn default() -> Self {
        Self { offset: 3e-6, lock_s: 0.05, lost_s: 0.05, search: true, attempts: 3 }
    }
}

/// What a sample, or the lack of one, says of the beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LockInput {
    /// All PSDs see light, and the error is known: its size in metres.
    Error {
        /// Metres.
        size: f64,
        /// The actuator stands at a limit.
        railed: bool,
    },
    /// Some see light.
    Partial {
        /// It says that the apex is elsewhere, and the stage can go there.
        elsewhere: bool,
        /// The beam may well be on the apex: a PSD is covered, or a channel is clipped.
        covered: bool,
        /// It says something else than when the loop gave up.
        news: bool,
        /// What is missing.
        cause: &'static str,
    },
    /// None does.
    Dark,
    /// Nothing can be said, for this reason.
    Unclear(&'static str),
}

/// What the loop does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// It brings the error to zero.
    Regulating,
    /// The stage stays where it is.
    Holding,
    /// The stage goes to where the apex should be.
    Jumping,
    /// The stage goes along a spiral.
    Searching,
    /// The stage stays at the last good place.
    Waiting,
}

/// A change of state, with its cause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    /// State before.
    pub from: LockState,
    /// State after.
    pub to: LockState,
    /// Why.
    pub cause: &'static str,
}

/// What follows from what was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LockDecision {
    /// What is to be done now.
    pub action: Action,
    /// A jump or a search begins, perhaps anew.
    pub begins: bool,
    /// The lock state has changed.
    pub transition: Option<Transition>,
}

/// The state machine.
#[derive(Clone, Debug)]
pub struct Lock {
    limits: LockLimits,
    state: LockState,
    action: Action,
    /// How long everything has been within limits, seconds.
    good_s: f64,
    /// How long the error has been unknown, seconds.
    blind_s: f64,
    mean_square: f64,
    /// No PSD saw light the last time.
    dark: bool,
    jumps: u32,
    /// Searches in vain since the last lock.
    attempts: u32,
    /// Light was found by a jump or a search, and not yet locked to.
    found: bool,
    /// Times it was found and lost again since the last lock.
    slips: u32,
    /// How long the stage has been off its limits, seconds.
    off_rail_s: f64,
}

/// The next state.
struct Next {
    action: Action,
    begins: bool,
    state: LockState,
    cause: &'static str,
}

impl Next {
    fn go_on(action: Action, state: LockState, cause: &'static str) -> Self {
        Self { action, begins: false, state, cause }
    }
}

impl Lock {
    /// The state machine of a loop in this mode.
    pub fn new(limits: LockLimits, mode: LoopMode) -> Self {
        let (state, action) = match mode {
            LoopMode::On => (LockState::Acquiring, Action::Regulating),
            LoopMode::Manual => (LockState::Manual, Action::Holding),
            LoopMode::Off | LoopMode::Shadow => (LockState::Off, Action::Holding),
        };
        Self {
            limits,
            state,
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

    /// Goes on with other limits. What must not be any more ends at once.
    pub fn retune(&mut self, limits: LockLimits) {
        self.limits = limits;
        if !limits.search && matches!(self.action, Action::Jumping | Action::Searching) {
            self.action = Action::Holding;
        }
    }

    /// Starts over in another mode.
    pub fn switch(&mut self, mode: LoopMode) -> Option<Transition> {
        let from = self.state;
        *self = Self::new(self.limits, mode);
        let cause = match mode {
            LoopMode::On => "switched on",
            LoopMode::Off | LoopMode::Shadow => "switched off",
            LoopMode::Manual => "switched to manual",
        };
        (from != self.state).then_some(Transition { from, to: self.state, cause })
    }

    /// A person wants it to look for the light: without waiting, and as if it had not yet looked.
    pub fn search(&mut self) {
        if self.action != Action::Regulating {
            (self.action, self.blind_s) = (Action::Holding, f64::INFINITY);
        }
        (self.jumps, self.attempts, self.slips) = (0, 0, 0);
    }

    /// The state.
    pub fn state(&self) -> LockState {
        self.state
    }

    /// Searches in vain since it was last locked.
    pub fn attempts(&self) -> u32 {
        self.attempts
    }

    /// Takes what was seen `dt` seconds after the last time; `arrived` if the jump or the search that was
    /// begun has come to its end.
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
        let transition =
            (from != next.state).then_some(Transition { from, to: next.state, cause: next.cause });
        LockDecision { action: next.action, begins: next.begins, transition }
    }

    fn regulate(&mut self, size: f64, railed: bool, dt: f64) -> Next {
        let found = matches!(self.action, Action::Jumping | Action::Searching);
        self.found |= found;
        (self.blind_s, self.jumps) = (0.0, 0);
        // A limit that is left and come to again and again is one event.
        self.off_rail_s = if railed { 0.0 } else { self.off_rail_s + dt };
        let railed = self.off_rail_s < OFF_RAIL * self.limits.lock_s || railed;
        let LockLimits { offset: limit, lock_s, .. } = self.limits;
        // The mean over about the confirmation time; the first sample after darkness starts it.
        let fresh = !self.mean_square.is_finite();
        let weight = if fresh { 1.0 } else { dt / (lock_s + dt) };
        let before = if fresh { 0.0 } else { self.mean_square };
        let square = size.min(FAR * limit).powi(2);
        self.mean_square = before + weight * (square - before);
        // Written so that a NaN is outside.
        let within = size <= limit && self.mean_square.sqrt() <= limit;
        let (state, cause) = if found && !railed {
            (LockState::Acquiring, "all PSDs see light")
        } else if railed {
            (LockState::Railed, "the steering stands at a limit")
        } else if !within {
            (LockState::Acquiring, "the offset, or its rms, is above the limit")
        } else if self.state == LockState::Locked || self.good_s + dt >= lock_s {
            (self.attempts, self.slips, self.found) = (0, 0, false);
            (LockState::Locked, "the offset is within the limit")
        } else {
            (LockState::Acquiring, "the offset is within the limit, not yet for long enough")
        };
        self.good_s = if within && !railed { self.good_s + dt } else { 0.0 };
        Next::go_on(Action::Regulating, state, cause)
    }

    /// The stage stays, for the time being.
    fn hold(&mut self, cause: &'static str, dt: f64) -> Next {
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
        const CAUSE: &str = "no PSD sees light";
        match self.action {
            Action::Regulating | Action::Holding => {
                let held = self.hold(CAUSE, dt);
                if self.limits.search && self.blind_s >= 2.0 * self.limits.lost_s {
                    return Self::look(CAUSE);
                }
                held
            }
            Action::Jumping if arrived => Self::look("no PSD sees light where the apex should be"),
            Action::Jumping => Self::capture(false),
            Action::Searching => self.look_on(arrived, CAUSE),
            Action::Waiting => Self::wait(),
        }
    }

    fn some_light(
        &mut self,
        elsewhere: bool,
        covered: bool,
        cause: &'static str,
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
            Action::Jumping => Self::look("a PSD sees too little light where the apex should be"),
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
        let cause = "a spot shows where the apex should be";
        Next { begins, ..Next::go_on(Action::Jumping, LockState::Acquiring, cause) }
    }

    fn look(cause: &'static str) -> Next {
        Next { begins: true, ..Next::go_on(Action::Searching, LockState::Searching, cause) }
    }

    fn look_on(&mut self, arrived: bool, cause: &'static str) -> Next {
        if !arrived {
            return Next::go_on(Action::Searching, LockState::Searching, cause);
        }
        (self.attempts, self.jumps) = (self.attempts + 1, 0);
        if self.attempts >= self.limits.attempts { Self::wait() } else { Self::look(cause) }
    }

    fn give_up() -> Next {
        let cause = "found and lost again too often (is steering.matrix right?): waits for a person who says `search`";
        Next::go_on(Action::Waiting, LockState::Held, cause)
    }

    fn wait() -> Next {
        let cause = "searched in vain: waits for light, or for a person who says `search`";
        Next::go_on(Action::Waiting, LockState::Held, cause)
    }
}
