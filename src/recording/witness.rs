//! What estimation says for the record.

use std::sync::Arc;

use trifacet_core::centering::LoopState;
use trifacet_core::estimation::Memory;
use trifacet_core::signals::{Identity, Sample, Scan};
use trifacet_core::time::{Mono, NS_PER_S};

use super::{Entry, Keyframe, Tap};
use crate::acquisition::Down;
use crate::config::Meaning;

/// Time between two keyframes: what is lost at most behind a damaged place.
const KEYFRAME_NS: i64 = NS_PER_S;

/// Puts what estimation is given on record, with all that a replay needs.
#[derive(Clone, Debug)]
pub struct Witness {
    tap: Tap,
    meaning: Arc<Meaning>,
    source: Option<Arc<Identity>>,
    last: Option<Scan>,
    /// When the next keyframe is due; none while nobody records.
    due: Option<Mono>,
}

impl Witness {
    /// For samples that mean this.
    pub fn new(tap: Tap, meaning: Arc<Meaning>) -> Self {
        Self { tap, meaning, source: None, last: None, due: None }
    }

    /// A source is up.
    pub fn source(&mut self, source: Arc<Identity>) {
        (self.source, self.last, self.due) = (Some(source), None, None);
    }

    /// From the next sample on they mean something else.
    pub fn meaning(&mut self, meaning: Arc<Meaning>) {
        (self.meaning, self.due) = (meaning, None);
    }

    /// A sample that estimation is about to take; `memory` is what it remembers of those before.
    pub fn sample(&mut self, sample: &Sample, scan: Scan, steering: &LoopState, memory: &Memory) {
        self.keyframe(scan.time, memory);
        self.put(|| Entry::Sample { scan, sample: *sample, steering: *steering });
        self.last = Some(scan);
    }

    /// Estimation is about to say that nothing comes.
    pub fn silence(&mut self, time: Mono, steering: &LoopState, why: Option<Down>, memory: &Memory) {
        self.keyframe(time, memory);
        self.put(|| Entry::Silence { time, steering: *steering, why: why.map(|down| down.to_string()) });
    }

    fn keyframe(&mut self, now: Mono, memory: &Memory) {
        if !self.tap.open() {
            self.due = None;
        } else if self.tap.wants_keyframe() || self.due.is_none_or(|due| now >= due) {
            self.due = Some(now + KEYFRAME_NS);
            let Self { meaning, source, last, .. } = self;
            let (meaning, source, last) = (Arc::clone(meaning), source.clone(), *last);
            let keyframe = || Box::new(Keyframe { meaning, source, last, memory: memory.clone() });
            if !self.tap.put(|| Entry::Keyframe(keyframe())) {
                self.due = None;
            }
        }
    }

    /// After a loss, nothing makes sense before the next keyframe.
    fn put(&mut self, entry: impl FnOnce() -> Entry) {
        if !self.tap.put(entry) {
            self.due = None;
        }
    }
}
