//! Counts of the contents of a file.

use std::fmt;

use super::Damage;
use crate::config::CalibrationContext;
use crate::recording::{Entry, Topic};

/// A gap that the file itself reports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gap {
    /// Number of missing samples, frames and changes; 0: unknown.
    pub entries: u64,
    /// Cause.
    pub reason: String,
}

impl fmt::Display for Gap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.entries {
            0 => write!(f, "{}", self.reason),
            n => write!(f, "{n} entries were not recorded: {}", self.reason),
        }
    }
}

/// Counts of what was read.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Size of the file, bytes.
    pub size: u64,
    /// Messages on each topic, in the order of [`Topic::ALL`].
    pub messages: [u64; Topic::ALL.len()],
    /// Messages on unknown topics.
    pub strange: u64,
    /// Times of the first and the last message, nanoseconds of UTC since 1970.
    pub time_ns: Option<[i64; 2]>,
    /// Samples that did not reach the estimation: lost before, or more than it could process.
    pub lost: u64,
    /// Changes of the lock state, as text.
    pub locks: Vec<String>,
    /// Identifiers of the configurations, in the order in which they came into force.
    pub configs: Vec<u32>,
    /// Index of the first sample, less the samples lost just before it, and of the last.
    pub samples: Option<[u64; 2]>,
    /// Sessions of the frames, in order.
    pub sessions: Vec<u32>,
    /// Gaps that the recorder reported.
    pub gaps: Vec<Gap>,
    /// Parts that cannot be read.
    pub damages: Vec<Damage>,
    /// Keyframes whose configuration is in a part that cannot be read.
    pub unfounded: u64,
    /// The file was closed properly.
    pub finished: bool,
    /// All data were read, up to the index.
    pub indexed: bool,
    /// Bytes of an incomplete record at the end.
    pub torn: u64,
}

impl Tally {
    /// Messages on a topic.
    pub fn of(&self, topic: Topic) -> u64 {
        self.messages[topic as usize]
    }

    /// Time from the first message to the last, seconds.
    pub fn seconds(&self) -> f64 {
        self.time_ns.map_or(0.0, |[first, last]| (last - first) as f64 * 1e-9)
    }

    /// Whether nothing is missing or damaged.
    pub fn whole(&self) -> bool {
        self.finished && !self.incomplete()
    }

    /// Bytes at the end whose data are lost: those of an incomplete chunk. 0 if only the index is damaged.
    pub fn lost_at_end(&self) -> u64 {
        if self.finished || self.indexed { 0 } else { self.torn }
    }

    /// Whether something is missing or damaged before the end.
    pub fn incomplete(&self) -> bool {
        !self.damages.is_empty() || !self.gaps.is_empty()
    }

    /// The consequence of a damaged configuration, if there is one.
    pub fn without_config(&self) -> Option<String> {
        let keyframes = if self.unfounded == 1 { "keyframe" } else { "keyframes" };
        (self.unfounded > 0).then(|| {
            format!(
                "{} {keyframes} cannot be used: the configuration before them cannot be read",
                self.unfounded
            )
        })
    }

    /// How the file ends, if it was not closed properly.
    pub fn unfinished(&self) -> Option<String> {
        match (self.finished, self.indexed, self.torn) {
            (true, ..) => None,
            (false, true, torn) => {
                Some(format!("the index after the data is damaged, {torn} bytes; no data are missing"))
            }
            (false, false, 0) if self.time_ns.is_none() => Some(
                "not closed: the recorder was killed before it wrote data, or has just begun; there is nothing \
                 to restore"
                    .into(),
            ),
            (false, false, 0) => Some("not closed: the recorder was killed, or is still writing".into()),
            (false, false, torn) => Some(format!(
                "not closed: the recorder was killed, or is still writing; the last {torn} bytes are an \
                 incomplete chunk, which is up to a second"
            )),
        }
    }

    pub(super) fn message(&mut self, topic: Option<Topic>, time_ns: i64) {
        let Some(topic) = topic else {
            self.strange += 1;
            return;
        };
        self.messages[topic as usize] += 1;
        let [first, last] = self.time_ns.unwrap_or([time_ns; 2]);
        self.time_ns = Some([first.min(time_ns), last.max(time_ns)]);
    }

    pub(super) fn entry(&mut self, entry: &Entry) {
        match entry {
            Entry::Sample { sample, .. } => {
                self.lost += u64::from(sample.lost);
                let first = sample.index.saturating_sub(sample.lost.into());
                self.samples = Some([self.samples.map_or(first, |[first, _]| first), sample.index]);
            }
            Entry::Frame { frame, .. } => {
                if self.sessions.last() != Some(&frame.session) {
                    self.sessions.push(frame.session);
                }
            }
            Entry::Lock { before, after, cause, .. } => {
                self.locks.push(format!("{} -> {}: {cause}", before.name(), after.name()));
            }
            Entry::Keyframe(keyframe) => self.config(&keyframe.context),
            Entry::Silence { .. } => {}
        }
    }

    pub(super) fn config(&mut self, context: &CalibrationContext) {
        let id = context.id();
        if self.configs.last() != Some(&id) {
            self.configs.push(id);
        }
    }
}
