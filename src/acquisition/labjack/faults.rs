//! Faults of the stream: counted, and logged at most once a second.

use std::mem::Discriminant;
use std::sync::Arc;

use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Mono, NS_PER_S};

use super::scans::Arrived;
use crate::acquisition::timebase::TickFault;

/// Counts of the stream's faults since the last line of the log.
#[derive(Debug)]
pub(super) struct Faults {
    counters: Arc<Counters>,
    lost: u64,
    repeated: u64,
    overruns: u64,
    reported_at: Option<Mono>,
    /// Kinds of clock faults that have been described since the start of the stream.
    described: Vec<Discriminant<TickFault>>,
}

impl Faults {
    pub(super) fn new(counters: Arc<Counters>) -> Self {
        Self { counters, lost: 0, repeated: 0, overruns: 0, reported_at: None, described: Vec::new() }
    }

    /// The stream has started: faults of the clock are described again.
    pub(super) fn restarted(&mut self) {
        self.described.clear();
    }

    pub(super) fn lost(&mut self, scans: u32) {
        self.counters.scans_lost.add(scans.into());
        self.lost += u64::from(scans);
    }

    pub(super) fn packet(&mut self, arrived: Arrived, scans: u32) {
        let repeated = u64::from(arrived.repeated) * u64::from(scans);
        self.counters.scans_repeated.add(repeated);
        self.counters.converter_overruns.add(arrived.overrun.into());
        self.repeated += repeated;
        self.overruns += u64::from(arrived.overrun);
    }

    pub(super) fn clock(&mut self, fault: TickFault, tick: u32) {
        self.counters.clock_faults.inc();
        let kind = std::mem::discriminant(&fault);
        if !self.described.contains(&kind) {
            self.described.push(kind);
            tracing::warn!(tick, "the clock of the T7 is wrong: {fault}");
        }
    }

    /// Logs the faults since the last line.
    pub(super) fn tell(&mut self, now: Mono) {
        let Self { lost, repeated, overruns, .. } = *self;
        let quiet = lost + repeated + overruns == 0;
        if quiet || self.reported_at.is_some_and(|reported_at| now - reported_at < NS_PER_S) {
            return;
        }
        tracing::warn!(lost, repeated, overruns, "faults in the stream of the T7");
        (self.lost, self.repeated, self.overruns, self.reported_at) = (0, 0, 0, Some(now));
    }
}
