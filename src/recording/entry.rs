//! Recorded events, and the channel from the fast side to the recorder.

use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::Matrix6;
use tokio::sync::mpsc;
use trifacet_core::centering::LoopState;
use trifacet_core::centering::lock::Transition;
use trifacet_core::estimation::EstimatorState;
use trifacet_core::signals::{Identity, Sample, Scan};
use trifacet_core::telemetry::Counters;
use trifacet_core::time::Mono;
use trifacet_wire::{LockState, PoseFrame};

use crate::config::CalibrationContext;

/// Entries that can wait while the recorder waits for a disk: 6 s at 10 kHz. Memory is used only for entries
/// that are waiting.
const QUEUE: usize = 128 * 1024;

/// A recorded event, in the order in which estimation processed it.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "nearly all entries are samples and frames")]
pub enum Entry {
    /// The state from which a replay can start.
    Keyframe(Box<Keyframe>),
    /// A sample, just before estimation processes it.
    Sample {
        /// The raw codes.
        scan: Scan,
        /// The sample that the channel map computed from them.
        sample: Sample,
        /// State of the loop as estimation knew it.
        steering: LoopState,
    },
    /// Estimation reported that there are no samples.
    Silence {
        /// Time of the report.
        time: Mono,
        /// State of the loop as estimation knew it.
        steering: LoopState,
        /// Why the source went down, if it did at this time.
        why: Option<String>,
    },
    /// The frame published for the preceding sample or silence.
    Frame {
        /// The frame.
        frame: PoseFrame,
        /// The monotonic time of `time_ns` in the frame.
        time: Mono,
        /// Covariance of the pose in the user's frame, m and rad, if there is a pose.
        covariance: Option<Matrix6<f64>>,
    },
    /// The lock state changed.
    Lock {
        /// Time of the change.
        time: Mono,
        /// State before.
        before: LockState,
        /// State after.
        after: LockState,
        /// Cause of the change.
        cause: Cow<'static, str>,
    },
}

impl Entry {
    /// A change of the lock state at this time.
    pub fn lock(time: Mono, Transition { from, to, cause }: Transition) -> Self {
        Self::Lock { time, before: from, after: to, cause: cause.text().into() }
    }

    /// Time of the event. A keyframe lies between two events.
    pub fn time(&self) -> Option<Mono> {
        match self {
            Entry::Keyframe(_) => None,
            Entry::Sample { scan, .. } => Some(scan.time),
            Entry::Silence { time, .. } | Entry::Frame { time, .. } | Entry::Lock { time, .. } => Some(*time),
        }
    }
}

/// The state of channel map and estimation between two samples. What follows can be replayed without what
/// precedes.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// Configuration and correction tables in force.
    pub context: Arc<CalibrationContext>,
    /// The source, if one is up.
    pub source: Option<Arc<Identity>>,
    /// The previous scan: the channel map interpolates from it.
    pub last: Option<Scan>,
    /// State of the estimation.
    pub memory: EstimatorState,
}

/// The fast side's end of the channel. While nothing is recorded, it only reads a flag.
#[derive(Clone, Debug, Default)]
pub struct RecordSender(Option<Queue>);

/// A queue to a recorder.
#[derive(Clone, Debug)]
struct Queue {
    to: mpsc::Sender<Entry>,
    open: Arc<AtomicBool>,
    keyframe: Arc<AtomicBool>,
    counters: Arc<Counters>,
}

/// The recorder's end of a [`RecordSender`].
#[derive(Debug)]
pub struct RecordReceiver {
    /// Entries in order. To be polled with `try_recv`: waking a sleeping receiver would cost the sender a
    /// system call.
    pub entries: mpsc::Receiver<Entry>,
    /// Whether entries are to be sent.
    pub open: Arc<AtomicBool>,
    /// Whether a keyframe is requested before its time. Files begin and end at keyframes.
    pub keyframe: Arc<AtomicBool>,
}

impl RecordSender {
    /// A sender, initially closed, and its receiver. Entries that do not fit are counted.
    pub fn new(counters: Arc<Counters>) -> (Self, RecordReceiver) {
        let (to, entries) = mpsc::channel(QUEUE);
        let (open, keyframe) = <(Arc<AtomicBool>, Arc<AtomicBool>)>::default();
        let queue = Queue { to, open: Arc::clone(&open), keyframe: Arc::clone(&keyframe), counters };
        (Self(Some(queue)), RecordReceiver { entries, open, keyframe })
    }

    /// Whether entries are to be sent.
    pub fn open(&self) -> bool {
        self.0.as_ref().is_some_and(|queue| queue.open.load(Ordering::Relaxed))
    }

    /// Whether a keyframe is requested before its time. Clears the request.
    pub fn wants_keyframe(&self) -> bool {
        self.0.as_ref().is_some_and(|queue| {
            queue.keyframe.load(Ordering::Relaxed) && queue.keyframe.swap(false, Ordering::Relaxed)
        })
    }

    /// Number of entries that fit into the queue; `None` while nothing is recorded.
    pub fn room(&self) -> Option<usize> {
        self.0.as_ref().filter(|_| self.open()).map(|queue| queue.to.capacity())
    }

    /// Sends an entry if the recorder is open. Returns false if the queue was full. Never waits.
    pub fn put(&self, entry: impl FnOnce() -> Entry) -> bool {
        let Some(queue) = self.0.as_ref().filter(|_| self.open()) else { return true };
        let fits = queue.to.try_send(entry()).is_ok();
        if !fits {
            queue.counters.recording_overflows.inc();
        }
        fits
    }
}
