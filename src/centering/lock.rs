//! The lock state: what the loop may claim, and the conditions under which it may.

use crate::config::CenteringConfig;

/// What the centering loop is doing; the numbers are those of the pose frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum LockState {
    /// The loop is switched off.
    #[default]
    Off = 0,
    /// A person moves the laser.
    Manual = 1,
    /// Looking for light.
    Searching = 2,
    /// Light is there; the offset is not yet within limits for long enough.
    Acquiring = 3,
    /// The offset, its rms and the light are within limits, and the actuator is off its rails.
    Locked = 4,
    /// The actuator stands at a limit.
    Railed = 5,
    /// No light for longer than the confirmation time.
    Lost = 6,
    /// The actuator holds: no light, or no trustworthy sample, for less than that.
    Held = 7,
}

impl LockState {
    /// Every state, in the order of the numbers.
    pub const ALL: [LockState; 8] = [
        LockState::Off,
        LockState::Manual,
        LockState::Searching,
        LockState::Acquiring,
        LockState::Locked,
        LockState::Railed,
        LockState::Lost,
        LockState::Held,
    ];

    /// What may be claimed of this state on a frame without samples or without light. The loop may have
    /// said it a moment before, or after.
    #[must_use]
    pub fn unseen(self) -> LockState {
        match self {
            LockState::Acquiring | LockState::Locked | LockState::Railed => LockState::Held,
            other => other,
        }
    }

    /// The state as a word: "off", "locked".
    pub fn name(self) -> &'static str {
        match self {
            LockState::Off => "off",
            LockState::Manual => "manual",
            LockState::Searching => "searching",
            LockState::Acquiring => "acquiring",
            LockState::Locked => "locked",
            LockState::Railed => "railed",
            LockState::Lost => "lost",
            LockState::Held => "held",
        }
    }
}

/// When the loop may call itself locked, and when it must call itself lost.
#[derive(Clone, Copy, Debug)]
pub struct LockLimits {
    /// Largest offset, and largest rms of it, metres.
    pub offset: f64,
    /// How long they must have been within limits, seconds.
    pub lock_s: f64,
    /// How long the light may be gone before it counts as lost, seconds.
    pub lost_s: f64,
}

impl LockLimits {
    /// From a checked configuration.
    pub fn new(config: &CenteringConfig) -> Self {
        Self {
            offset: config.lock_limit_um * 1e-6,
            lock_s: config.lock_time_ms * 1e-3,
            lost_s: config.lost_time_ms * 1e-3,
        }
    }
}

/// What a sample, or the lack of one, says of the beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sight {
    /// The offset is known: its size in metres.
    Offset {
        /// Metres.
        size: f64,
        /// The actuator stands at a limit.
        railed: bool,
    },
    /// Nothing is known, for this reason.
    Nothing(&'static str),
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

/// The state machine.
#[derive(Clone, Debug)]
pub struct Lock {
    limits: LockLimits,
    state: LockState,
    /// How long everything has been within limits, seconds.
    good_s: f64,
    /// How long nothing has been seen, seconds.
    blind_s: f64,
    mean_square: f64,
}

impl Lock {
    /// Off if the loop is not `on`.
    pub fn new(limits: LockLimits, on: bool) -> Self {
        let state = if on { LockState::Acquiring } else { LockState::Off };
        Self { limits, state, good_s: 0.0, blind_s: 0.0, mean_square: f64::INFINITY }
    }

    /// Goes on with other limits; switched on or off, it starts over.
    pub fn retune(&mut self, limits: LockLimits, on: bool) -> Option<Transition> {
        self.limits = limits;
        if on == (self.state != LockState::Off) {
            return None;
        }
        let from = self.state;
        *self = Self::new(limits, on);
        let cause = if on { "switched on" } else { "switched off" };
        Some(Transition { from, to: self.state, cause })
    }

    /// The state.
    pub fn state(&self) -> LockState {
        self.state
    }

    /// Takes what was seen `dt` seconds after the last time.
    pub fn update(&mut self, sight: Sight, dt: f64) -> Option<Transition> {
        if self.state == LockState::Off {
            return None;
        }
        let (to, cause) = match sight {
            Sight::Nothing(cause) => self.blind(dt, cause),
            Sight::Offset { size, railed } => self.seeing(size, railed, dt),
        };
        let from = std::mem::replace(&mut self.state, to);
        (from != to).then_some(Transition { from, to, cause })
    }

    fn blind(&mut self, dt: f64, cause: &'static str) -> (LockState, &'static str) {
        self.good_s = 0.0;
        self.mean_square = f64::INFINITY;
        self.blind_s += dt;
        let lost = self.blind_s >= self.limits.lost_s;
        (if lost { LockState::Lost } else { LockState::Held }, cause)
    }

    fn seeing(&mut self, size: f64, railed: bool, dt: f64) -> (LockState, &'static str) {
        self.blind_s = 0.0;
        let LockLimits { offset: limit, lock_s, .. } = self.limits;
        // The mean over about the confirmation time; the first sample after darkness starts it.
        let fresh = !self.mean_square.is_finite();
        let weight = if fresh { 1.0 } else { dt / (lock_s + dt) };
        let before = if fresh { 0.0 } else { self.mean_square };
        self.mean_square = before + weight * (size * size - before);
        if railed {
            self.good_s = 0.0;
            return (LockState::Railed, "the steering stands at a limit");
        }
        // Written so that a NaN is outside.
        let within = size <= limit && self.mean_square.sqrt() <= limit;
        if !within {
            self.good_s = 0.0;
            return (LockState::Acquiring, "the offset, or its rms, is above the limit");
        }
        self.good_s += dt;
        let locked = self.state == LockState::Locked || self.good_s >= lock_s;
        (if locked { LockState::Locked } else { LockState::Acquiring }, "the offset is within the limit")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: LockLimits = LockLimits { offset: 3e-6, lock_s: 0.05, lost_s: 0.05 };
    const DT: f64 = 1e-3;

    fn feed(lock: &mut Lock, sight: Sight, n: usize) -> LockState {
        for _ in 0..n {
            let _ = lock.update(sight, DT);
        }
        lock.state()
    }

    fn off_by(size: f64) -> Sight {
        Sight::Offset { size, railed: false }
    }

    #[test]
    fn locked_only_after_the_confirmation_time_within_limits() {
        let mut lock = Lock::new(LIMITS, true);
        assert_eq!(feed(&mut lock, off_by(1e-6), 48), LockState::Acquiring);
        assert_eq!(feed(&mut lock, off_by(1e-6), 3), LockState::Locked);
        assert_eq!(feed(&mut lock, off_by(4e-6), 1), LockState::Acquiring);
        assert_eq!(feed(&mut lock, off_by(f64::NAN), 1000), LockState::Acquiring);
    }

    #[test]
    fn a_large_rms_is_not_locked_even_if_samples_in_between_are_small() {
        let mut lock = Lock::new(LIMITS, true);
        feed(&mut lock, off_by(100e-6), 10);
        assert_eq!(feed(&mut lock, off_by(1e-6), 60), LockState::Acquiring);
        assert_eq!(feed(&mut lock, off_by(1e-6), 400), LockState::Locked);
    }

    #[test]
    fn railed_is_not_locked() {
        let mut lock = Lock::new(LIMITS, true);
        feed(&mut lock, off_by(0.0), 60);
        let railed = Sight::Offset { size: 0.0, railed: true };
        assert_eq!(feed(&mut lock, railed, 1), LockState::Railed);
        assert_eq!(feed(&mut lock, off_by(0.0), 10), LockState::Acquiring);
    }

    #[test]
    fn no_light_is_held_then_lost_and_starts_over() {
        let mut lock = Lock::new(LIMITS, true);
        feed(&mut lock, off_by(0.0), 60);
        let dark = Sight::Nothing("dark");
        let held = lock.update(dark, DT).unwrap();
        assert_eq!((held.from, held.to, held.cause), (LockState::Locked, LockState::Held, "dark"));
        assert_eq!(feed(&mut lock, dark, 60), LockState::Lost);
        assert_eq!(feed(&mut lock, off_by(0.0), 10), LockState::Acquiring);
    }

    #[test]
    fn off_stays_off_until_it_is_switched_on() {
        let mut lock = Lock::new(LIMITS, false);
        assert_eq!(feed(&mut lock, off_by(0.0), 100), LockState::Off);
        assert_eq!(lock.retune(LIMITS, false), None);
        assert_eq!(lock.retune(LIMITS, true).unwrap().to, LockState::Acquiring);
        assert_eq!(feed(&mut lock, off_by(0.0), 40), LockState::Acquiring);
        assert_eq!(feed(&mut lock, off_by(0.0), 20), LockState::Locked);
        assert_eq!(lock.retune(LockLimits { offset: 1e-6, ..LIMITS }, true), None);
        assert_eq!(feed(&mut lock, off_by(2e-6), 1), LockState::Acquiring, "the new limit counts");
        assert_eq!(lock.retune(LIMITS, false).unwrap().to, LockState::Off);
    }
}
