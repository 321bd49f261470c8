//! Records the inputs of the estimation.

use std::sync::Arc;

use trifacet_core::centering::LoopState;
use trifacet_core::estimation::EstimatorState;
use trifacet_core::signals::{Identity, Sample, Scan};
use trifacet_core::time::{Mono, NS_PER_S};

use super::{Entry, Keyframe, RecordSender};
use crate::acquisition::SourceError;
use crate::config::CalibrationContext;

/// Interval of keyframes: at most this much is lost after a damaged part.
const KEYFRAME_NS: i64 = NS_PER_S;

/// Records the inputs of the estimation, with keyframes for a replay.
#[derive(Clone, Debug)]
pub struct EstimationRecorder {
    records: RecordSender,
    context: Arc<CalibrationContext>,
    source: Option<Arc<Identity>>,
    last: Option<Scan>,
    /// Time of the next keyframe; `None` while nothing is recorded.
    due: Option<Mono>,
}

impl EstimationRecorder {
    /// A recorder for samples of this configuration.
    pub fn new(records: RecordSender, context: Arc<CalibrationContext>) -> Self {
        Self { records, context, source: None, last: None, due: None }
    }

    /// Notes that a source is up.
    pub fn source(&mut self, source: Arc<Identity>) {
        (self.source, self.last, self.due) = (Some(source), None, None);
    }

    /// Notes that the configuration changes with the next sample.
    pub fn context(&mut self, context: Arc<CalibrationContext>) {
        (self.context, self.due) = (context, None);
    }

    /// Records a sample before estimation processes it. `memory` is the state of the estimation before it.
    pub fn sample(&mut self, sample: &Sample, scan: Scan, steering: &LoopState, memory: &EstimatorState) {
        self.keyframe(scan.time, memory);
        self.put(|| Entry::Sample { scan, sample: *sample, steering: *steering });
        self.last = Some(scan);
    }

    /// Records that estimation is about to report silence.
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

    /// Sends an entry. After a loss, entries cannot be replayed before the next keyframe, which is then due.
    fn put(&mut self, entry: impl FnOnce() -> Entry) {
        if !self.records.put(entry) {
            self.due = None;
        }
    }
}
