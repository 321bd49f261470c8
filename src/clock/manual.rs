//! A clock that is advanced by the test.

use std::io;
use std::sync::Arc;

use tokio::sync::watch;
use trifacet_core::time::{Clock, Mono};

use super::pace::{Timer, Waiting};

/// Stands still until it is advanced; clones show the same time.
#[derive(Clone, Debug)]
pub(crate) struct ManualClock(Arc<watch::Sender<Mono>>);

impl ManualClock {
    pub(crate) fn new() -> Self {
        Self(Arc::new(watch::Sender::new(Mono(1_000_000_000))))
    }

    pub(crate) fn advance(&self, ns: i64) {
        self.0.send_modify(|now| *now = *now + ns);
    }
}

impl Clock for ManualClock {
    fn now(&self) -> Mono {
        *self.0.borrow()
    }
}

impl Waiting for ManualClock {
    type Timer = watch::Receiver<Mono>;

    fn timer(&self) -> io::Result<Self::Timer> {
        Ok(self.0.subscribe())
    }
}

impl Timer for watch::Receiver<Mono> {
    async fn until(&mut self, moment: Mono) -> io::Result<()> {
        self.wait_for(|now| *now >= moment).await.map(drop).map_err(io::Error::other)
    }
}
