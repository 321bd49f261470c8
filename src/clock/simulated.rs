//! A clock for simulations that nothing outside takes part in: a wait moves the clock on and ends at once.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use trifacet_core::time::{Clock, Mono};

use super::SystemClock;
use super::pace::{Timer, Waiting};

/// Stands still between waits; clones show the same time.
#[derive(Clone, Debug)]
pub struct SimulatedClock(Arc<AtomicI64>);

impl SimulatedClock {
    /// A clock that begins at the present time of the machine.
    pub fn starting_now() -> Self {
        Self(Arc::new(AtomicI64::new(SystemClock.now().0)))
    }
}

impl Clock for SimulatedClock {
    fn now(&self) -> Mono {
        Mono(self.0.load(Ordering::Relaxed))
    }
}

impl Waiting for SimulatedClock {
    type Timer = Self;

    fn timer(&self) -> io::Result<Self> {
        Ok(self.clone())
    }
}

impl Timer for SimulatedClock {
    async fn until(&mut self, moment: Mono) -> io::Result<()> {
        self.0.fetch_max(moment.0, Ordering::Relaxed);
        Ok(())
    }
}
