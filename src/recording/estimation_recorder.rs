//! What estimation says for the record.

use std::sync::Arc;

use trifacet_core::centering::LoopState;
use trifacet_core::estimation::EstimatorState;
use trifacet_core::signals::{Identity, Sample, Scan};
use trifacet_core::time::{Mono, NS_PER_S};

use super::{Entry, Keyframe, RecordSender};
use crate::acquisition::SourceError;
use crate::config::CalibrationContext;

/// Time between two keyframes: what is lost at most behind a damaged place.
const KEYFRAME_NS: i64 = NS_PER_S;

/// Puts what estimation is given on record, with all that a replay needs.
#[derive(Clone, Debug)]
pub struct EstimationRecorder {
    records: RecordSender,
    context: Arc<CalibrationContext>,
    source: Option<Arc<Identity>>,
    last: Option<Scan>,
    /// When the next keyframe is due; none while nobody records.
    due: Option<Mono>,
}

impl EstimationRecorder {
    /// For samples that mean this.
    pub fn new(records: RecordSender, context: Arc<CalibrationContext>) -> Self {
        Self { records, context, source: None, last: None, due: None }
    }

    /// A source is up.
    pub fn source(&mut self, source: Arc<Identity>) {
        (self.source, self.last, self.due) = (Some(source), None, None);
    }

    /// From the next sample on they mean something else.
    pub fn context(&mut self, context: Arc<CalibrationContext>) {
        (self.context, self.due) = (context, None);
    }

    /// A sample that estimation is about to take; `memory` is what it remembers of those before.
    pub fn sample(&mut self, sample: &Sample, scan: Scan, steering: &LoopState, memory: &EstimatorState) {
        self.keyframe(scan.time, memory);
        self.put(|| Entry::Sample { scan, sample: *sample, steering: *steering });
        self.last = Some(scan);
    }

    /// Estimation is about to say that nothing comes.
    pub fn silence(
        &mut self,
        time: Mono,
        steering: &LoopState,
        why: Option<SourceError>,
        memory: &EstimatorState,
    ) {
        self.keyframe(time, memory);
        self.put(|| Entry::Silence { time, steering: *steering, why: why.map(|down| down.to_string()) });
    }

    fn keyframe(&mut self, now: Mono, memory: &EstimatorState) {
        if !self.records.open() {
            self.due = None;
        } else if self.records.wants_keyframe() || self.due.is_none_or(|due| now >= due) {
            self.due = Some(now + KEYFRAME_NS);
            let Self { context, source, last, .. } = self;
            let (context, source, last) = (Arc::clone(context), source.clone(), *last);
            let keyframe = || Box::new(Keyframe { context, source, last, memory: memory.clone() });
            if !self.records.put(|| Entry::Keyframe(keyframe())) {
                self.due = None;
            }
        }
    }

    /// After a loss, nothing makes sense before the next keyframe.
    fn put(&mut self, entry: impl FnOnce() -> Entry) {
        if !self.records.put(entry) {
            self.due = None;
        }
    }
}
