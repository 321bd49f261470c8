//! Faults of the link to the board: counted individually, logged at most once a second.

use std::mem::Discriminant;
use std::sync::Arc;

use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_wire::board::BoardScan;

use crate::acquisition::timebase::TickFault;

/// Faults between board and host, in the order of the names below.
#[derive(Clone, Copy, Debug)]
pub(super) enum LinkFault {
    /// A scan never arrived.
    Lost,
    Repeated,
    Late,
    Corrupted,
    /// An undamaged frame with invalid contents.
    Unknown,
    /// The board did not understand a frame of the host.
    BoardError,
    /// The board read its converter too late.
    Overrun,
    /// The outputs hold or park because no command arrived in time.
    LeaseExpired,
    /// The tick disagrees with the sequence numbers or with the clock of the host.
    Clock,
}

/// Counts faults without an event of their own in the daemon's counters, and logs them in summary lines.
#[derive(Debug)]
pub(super) struct Tally {
    counters: Arc<Counters>,
    /// Counts since the last line: the name of each kind, and its number.
    recent: [(&'static str, u64); 9],
    reported_at: Option<Mono>,
    /// Kinds of clock faults that have been described since the start of the board.
    described: Vec<Discriminant<TickFault>>,
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
            "faults of its clock",
        ];
        Self { counters, recent: names.map(|name| (name, 0)), reported_at: None, described: Vec::new() }
    }

    /// The board has started: faults of its clock are described again.
    pub(super) fn restarted(&mut self) {
        self.described.clear();
    }

    /// Counts `n` lost scans.
    pub(super) fn lost(&mut self, n: u32) {
        self.add(LinkFault::Lost, n.into());
    }

    pub(super) fn count(&mut self, mishap: LinkFault) {
        self.add(mishap, 1);
    }

    /// Counts a fault of the board's clock. The first one of each kind is described.
    pub(super) fn clock_fault(&mut self, fault: TickFault, scan: &BoardScan) {
        self.count(LinkFault::Clock);
        let kind = std::mem::discriminant(&fault);
        if !self.described.contains(&kind) {
            self.described.push(kind);
            tracing::warn!(
                sequence = scan.sequence,
                tick = scan.tick,
                "the clock of the board is wrong: {fault}"
            );
        }
    }

    fn add(&mut self, mishap: LinkFault, n: u64) {
        let counters = &self.counters;
        let counter = match mishap {
            LinkFault::Lost => &counters.scans_lost,
            LinkFault::Repeated => &counters.scans_repeated,
            LinkFault::Late => &counters.scans_late,
            LinkFault::Corrupted => &counters.frames_corrupted,
            LinkFault::Unknown => &counters.frames_unknown,
            LinkFault::BoardError => &counters.board_errors,
            LinkFault::Overrun => &counters.converter_overruns,
            LinkFault::LeaseExpired => &counters.leases_expired,
            LinkFault::Clock => &counters.clock_faults,
        };
        counter.add(n);
        self.recent[mishap as usize].1 += n;
    }

    /// Logs the faults since the last line, at most once a second.
    pub(super) fn tell(&mut self, now: Mono) {
        let no_faults = self.recent.iter().all(|(_, n)| *n == 0);
        if no_faults || self.reported_at.is_some_and(|reported_at| now - reported_at < NS_PER_S) {
            return;
        }
        let what: Vec<_> =
            self.recent.iter().filter(|(_, n)| *n > 0).map(|(name, n)| format!("{name} {n}")).collect();
        tracing::warn!("board link: {}", what.join(", "));
        self.recent.iter_mut().for_each(|(_, n)| *n = 0);
        self.reported_at = Some(now);
    }
}
