//! The clocks of this machine: the monotonic clock, timers on it, and UTC.

#[cfg(test)]
pub(crate) mod manual;
pub mod pace;
pub mod simulated;
pub mod utc;

use rustix::time::{ClockId, clock_gettime};
use trifacet_core::time::{Clock, Mono, NS_PER_S};

/// The monotonic clock of the machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now(&self) -> Mono {
        let t = clock_gettime(ClockId::Monotonic);
        Mono(t.tv_sec * NS_PER_S + t.tv_nsec)
    }
}
