//! Which command the outputs had taken over when a scan was taken.

use std::collections::VecDeque;

use trifacet_core::time::Mono;

/// The accepted commands, up to the last scan.
#[derive(Clone, Debug, Default)]
pub struct AppliedCommands {
    /// Commands since the last scan, with their times.
    newer: VecDeque<(Mono, u32)>,
    last: Option<u32>,
}

impl AppliedCommands {
    /// Records a command that the outputs take over at `now`.
    pub fn accept(&mut self, id: u32, now: Mono) {
        self.newer.push_back((now, id));
    }

    /// The last command that was applied in a scan of this time; not earlier than the previous one.
    pub fn at(&mut self, time: Mono) -> Option<u32> {
        while let Some((_, id)) = self.newer.pop_front_if(|(since, _)| *since <= time) {
            self.last = Some(id);
        }
        self.last
    }
}
