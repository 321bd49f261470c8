//! Losses, counted one by one and told to people once a second.

use std::sync::Arc;

use crate::{
    clock::{Mono, NS_PER_S},
    monitor::Counters,
};

/// What goes wrong between the board and here.
#[derive(Clone, Copy, Debug)]
pub(super) enum Mishap {
    /// So many scans never arrived.
    Lost(u32),
    Repeated,
    Late,
    Corrupted,
    /// A whole frame that makes no sense.
    Unknown,
    /// The board did not understand a frame of ours.
    BoardError,
    /// The converter was read too late.
    Overrun,
    /// The outputs hold or park because commands stopped coming in time.
    LeaseExpired,
}

/// Counts into the daemon's counters, and logs what came together.
#[derive(Debug)]
pub(super) struct Tally {
    counters: Arc<Counters>,
    /// Since the last line: each kind with its name.
    recent: [(&'static str, u64); 8],
    told: Option<Mono>,
}

impl Tally {
    pub(super) fn new(counters: Arc<Counters>) -> Self {
        let names = [
            "lost",
            "repeated",
            "late",
            "corrupted",
            "unknown",
            "not understood by the board",
            "overruns",
            "leases expired",
        ];
        Self { counters, recent: names.map(|name| (name, 0)), told: None }
    }

    pub(super) fn count(&mut self, mishap: Mishap) {
        let counters = &self.counters;
        let (place, counter, n) = match mishap {
            Mishap::Lost(n) => (0, &counters.scans_lost, u64::from(n)),
            Mishap::Repeated => (1, &counters.scans_repeated, 1),
            Mishap::Late => (2, &counters.scans_late, 1),
            Mishap::Corrupted => (3, &counters.frames_corrupted, 1),
            Mishap::Unknown => (4, &counters.frames_unknown, 1),
            Mishap::BoardError => (5, &counters.board_errors, 1),
            Mishap::Overrun => (6, &counters.converter_overruns, 1),
            Mishap::LeaseExpired => (7, &counters.leases_expired, 1),
        };
        self.recent[place].1 += n;
        counter.add(n);
    }

    /// Logs what came together since the last line, at most once a second.
    pub(super) fn tell(&mut self, now: Mono) {
        let quiet = self.recent.iter().all(|(_, n)| *n == 0);
        if quiet || self.told.is_some_and(|told| now - told < NS_PER_S) {
            return;
        }
        let what: Vec<_> =
            self.recent.iter().filter(|(_, n)| *n > 0).map(|(name, n)| format!("{n} {name}")).collect();
        tracing::warn!("board link: {}", what.join(", "));
        self.recent.iter_mut().for_each(|(_, n)| *n = 0);
        self.told = Some(now);
    }
}
