//! What is recorded, and the way it takes from the fast side.

use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::Matrix6;
use tokio::sync::mpsc;
use trifacet_core::centering::LoopState;
use trifacet_core::estimation::EstimatorState;
use trifacet_core::signals::{Identity, Sample, Scan};
use trifacet_core::telemetry::Counters;
use trifacet_core::time::Mono;
use trifacet_wire::{LockState, PoseFrame};

use crate::config::CalibrationContext;

/// Entries that may wait for the recorder, which may wait for a disk: 6 s at 10 kHz. Takes memory only
/// while they wait.
const QUEUE: usize = 128 * 1024;

/// One thing that happened, in the order in which estimation saw it.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "nothing is allocated for a sample")]
pub enum Entry {
    /// All that is needed to go on from here.
    Keyframe(Box<Keyframe>),
    /// A sample, just before estimation took it.
    Sample {
        /// The raw codes.
        scan: Scan,
        /// What the channel map made of them.
        sample: Sample,
        /// What estimation knew of the loop.
        steering: LoopState,
    },
    /// Estimation was to say that no samples come.
    Silence {
        /// When.
        time: Mono,
        /// What it knew of the loop.
        steering: LoopState,
        /// Why the source went down, if that was the moment.
        why: Option<String>,
    },
    /// What was published of the sample or the silence before.
    Frame {
        /// The frame.
        frame: PoseFrame,
        /// The moment that is `time_ns` in the frame.
        time: Mono,
        /// Covariance of the pose in the user's frame, m and rad; with a pose.
        covariance: Option<Matrix6<f64>>,
    },
    /// The lock state changed.
    Lock {
        /// When.
        time: Mono,
        /// State before.
        before: LockState,
        /// State after.
        after: LockState,
        /// Why.
        cause: Cow<'static, str>,
    },
}

impl Entry {
    /// When it happened. A keyframe stands between two moments.
    pub fn time(&self) -> Option<Mono> {
        match self {
            Entry::Keyframe(_) => None,
            Entry::Sample { scan, .. } => Some(scan.time),
            Entry::Silence { time, .. } | Entry::Frame { time, .. } | Entry::Lock { time, .. } => Some(*time),
        }
    }
}

/// The state of channel map and estimation between two samples: what comes after it can be replayed without
/// what was before.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// Configuration and correction tables in force.
    pub context: Arc<CalibrationContext>,
    /// The source, if one has come up.
    pub source: Option<Arc<Identity>>,
    /// The scan before: the channel map interpolates from it.
    pub last: Option<Scan>,
    /// What estimation remembers.
    pub memory: EstimatorState,
}

/// Where the fast side hands over what happens. Costs a look at a flag while nobody wants it.
#[derive(Clone, Debug, Default)]
pub struct RecordSender(Option<Queue>);

/// A tap that leads somewhere.
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
    /// What came, in order. To be asked with `try_recv` now and then: a receiver that sleeps costs whoever
    /// wakes it a call of the system.
    pub entries: mpsc::Receiver<Entry>,
    /// Whether entries are wanted.
    pub open: Arc<AtomicBool>,
    /// Whether a keyframe is wanted before its time: a file can begin, and the one before end, only there.
    pub keyframe: Arc<AtomicBool>,
}

impl RecordSender {
    /// A sender, closed for now, and its other end. What does not fit is counted.
    pub fn new(counters: Arc<Counters>) -> (Self, RecordReceiver) {
        let (to, entries) = mpsc::channel(QUEUE);
        let (open, keyframe) = <(Arc<AtomicBool>, Arc<AtomicBool>)>::default();
        let queue = Queue { to, open: Arc::clone(&open), keyframe: Arc::clone(&keyframe), counters };
        (Self(Some(queue)), RecordReceiver { entries, open, keyframe })
    }

    /// Whether entries are wanted.
    pub fn open(&self) -> bool {
        self.0.as_ref().is_some_and(|queue| queue.open.load(Ordering::Relaxed))
    }

    /// Whether a keyframe is wanted before its time: said once.
    pub fn wants_keyframe(&self) -> bool {
        self.0.as_ref().is_some_and(|queue| {
            queue.keyframe.load(Ordering::Relaxed) && queue.keyframe.swap(false, Ordering::Relaxed)
        })
    }

    /// Hands an entry over, if it is wanted; false if it was and there was no room. Never waits.
    pub fn put(&self, entry: impl FnOnce() -> Entry) -> bool {
        let Some(queue) = self.0.as_ref().filter(|_| self.open()) else { return true };
        let fits = queue.to.try_send(entry()).is_ok();
        if !fits {
            queue.counters.recording_overflows.inc();
        }
        fits
    }
}
