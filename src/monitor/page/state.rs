//! Data shown on the page, from all frames. Pure.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;
use trifacet_core::telemetry::Counters;
use trifacet_wire::stream::LockEvent;
use trifacet_wire::{PoseFrame, Status};

use super::bins::{Bin, History, Past};
use super::events::{Event, Events};
use super::spectrum::{Spectrum, Welch};
use super::status_history::{Spell, StatusHistory};
use crate::monitor::health::{Readiness, Standstill};
use crate::publishing::columns::Columns;
use crate::recording::handle::State;

/// Updates between two that include counters and spectrum.
const RARELY: u64 = 10;

/// Data kept for the page.
#[derive(Debug, Default)]
pub struct PageState {
    past: Past,
    history: StatusHistory,
    /// What has changed.
    pub events: Events,
    lately: Lately,
    /// Present while there are viewers.
    welch: Option<Welch>,
    /// Session and configuration of the newest frame.
    of: Option<(u32, u32)>,
    updates: u64,
}

/// Counts since the last update.
#[derive(Debug, Default)]
struct Lately {
    frames: u32,
    invalid: u32,
    lost: u64,
    delays_ns: Vec<u32>,
}

/// Changes since the previous update.
#[derive(Debug, Serialize)]
pub struct Update {
    /// Number of the update, by which a viewer detects missing ones.
    number: u64,
    /// The newest frame, with the names of the stream.
    frame: Option<Columns>,
    /// The part of the daemon that stalls.
    dead: Option<Standstill>,
    ready: Readiness,
    lock_since_ms: f64,
    /// The cause of the frame's lock state, if it is known.
    lock: Option<LockEvent>,
    history: Vec<Spell>,
    bins: Vec<Bin>,
    frames: u32,
    invalid: u32,
    lost: u64,
    /// Median, 99th percentile and maximum of the time from a sample to its datagram, microseconds.
    delay_us: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    counters: Option<BTreeMap<&'static str, u64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    spectrum: Option<Spectrum>,
    /// All events, if there are new ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    events: Option<Vec<Event>>,
    /// State of the recorder.
    #[serde(skip_serializing_if = "Option::is_none")]
    recording: Option<Value>,
}

impl PageState {
    /// Takes every frame in turn, with `rate_hz` frames per second. `watched`: there are viewers.
    pub fn frames(&mut self, batch: &[PoseFrame], rate_hz: f64, watched: bool) {
        if !watched {
            (self.welch, self.lately) = (None, Lately::default());
            self.past.news();
        } else if self
            .welch
            .as_ref()
            .is_none_or(|welch| welch.rate_hz() < rate_hz || welch.rate_hz() > rate_hz)
        {
            self.welch = Some(Welch::new(rate_hz));
        }
        for frame in batch {
            self.meaning(frame, rate_hz);
            self.past.frame(frame);
            self.history.frame(frame);
            if let Some(welch) = &mut self.welch {
                welch.frame(frame);
                self.lately.frame(frame);
            }
        }
    }

    /// With another session or configuration, poses have another meaning: a spectrum over the change would be
    /// that of the step.
    fn meaning(&mut self, frame: &PoseFrame, rate_hz: f64) {
        let of = Some((frame.session, frame.config));
        if self.of.is_some() && self.of != of && self.welch.is_some() {
            self.welch = Some(Welch::new(rate_hz));
        }
        self.of = of;
    }

    /// The history with which a chart begins.
    pub fn history(&self, span_s: u32) -> History {
        self.past.history(span_s)
    }

    /// Makes the next update.
    pub fn update(
        &mut self,
        newest: Option<&PoseFrame>,
        dead: Option<Standstill>,
        ready: Readiness,
        lock: Option<LockEvent>,
        counters: &Counters,
        recording: &State,
    ) -> Update {
        let mut lately = std::mem::take(&mut self.lately);
        let rarely = self.updates.is_multiple_of(RARELY);
        self.updates += 1;
        Update {
            number: self.updates,
            frame: newest.map(Columns::of),
            dead,
            ready,
            lock_since_ms: self.history.lock_since_ms(),
            lock,
            history: self.history.list(),
            bins: self.past.news(),
            frames: lately.frames,
            invalid: lately.invalid,
            lost: lately.lost,
            delay_us: lately.delay_us(),
            counters: rarely.then(|| counters.list().into_iter().collect()),
            spectrum: self.welch.as_ref().filter(|_| rarely).and_then(Welch::spectrum),
            events: if rarely { self.events.news() } else { None },
            recording: rarely.then(|| recording.tell()),
        }
    }
}

impl Lately {
    fn frame(&mut self, frame: &PoseFrame) {
        self.frames += 1;
        self.invalid += u32::from(frame.pose[0].is_nan());
        self.lost += u64::from(frame.lost);
        // A frame without samples has no delay.
        if !frame.status.has(Status::SOURCE_DOWN) {
            self.delays_ns.push(frame.send_delay_ns);
        }
    }

    fn delay_us(&mut self) -> Option<[f64; 3]> {
        self.delays_ns.sort_unstable();
        let last = self.delays_ns.len().checked_sub(1)?;
        Some([last / 2, last * 99 / 100, last].map(|i| f64::from(self.delays_ns[i]) * 1e-3))
    }
}
