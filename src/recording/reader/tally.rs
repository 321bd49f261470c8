//! What a file holds.

use std::fmt;

use super::Damage;
use crate::config::CalibrationContext;
use crate::recording::{Entry, Topic};

/// Something that was left out, as the file itself tells.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gap {
    /// So many samples, frames and changes; 0: not known.
    pub entries: u64,
    /// Why.
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
    /// Messages on topics of other programs.
    pub strange: u64,
    /// When the first and the last message were written, nanoseconds of UTC since 1970.
    pub time_ns: Option<[i64; 2]>,
    /// Samples that were lost before they came, or were too many.
    pub lost: u64,
    /// Changes of the lock state.
    pub locks: Vec<String>,
    /// Fingerprints of the configurations, in the order in which they came into force.
    pub configs: Vec<u32>,
    /// Index of the first sample, with what was lost just before it, and of the last.
    pub samples: Option<[u64; 2]>,
    /// Runs of the daemon that the frames are of, in their order.
    pub sessions: Vec<u32>,
    /// What had to be left out.
    pub gaps: Vec<Gap>,
    /// What cannot be read.
    pub damages: Vec<Damage>,
    /// Keyframes whose configuration was in a place that cannot be read.
    pub unfounded: u64,
    /// The file was closed as it should be.
    pub finished: bool,
    /// All data were read, up to the index behind them.
    pub indexed: bool,
    /// Bytes at the end that are no whole record.
    pub torn: u64,
}

impl Tally {
    /// Messages on a topic.
    pub fn of(&self, topic: Topic) -> u64 {
        self.messages[topic as usize]
    }

    /// From the first message to the last, seconds.
    pub fn seconds(&self) -> f64 {
        self.time_ns.map_or(0.0, |[first, last]| (last - first) as f64 * 1e-9)
    }

    /// Nothing is missing, and nothing is damaged.
    pub fn whole(&self) -> bool {
        self.finished && !self.incomplete()
    }

    /// Something is missing before the end.
    pub fn incomplete(&self) -> bool {
        !self.damages.is_empty() || !self.gaps.is_empty()
    }

    /// What damage of the configuration costs.
    pub fn without_config(&self) -> Option<String> {
        let keyframes = if self.unfounded == 1 { "keyframe" } else { "keyframes" };
        (self.unfounded > 0).then(|| {
            format!(
                "{} {keyframes} cannot be used: the configuration before them cannot be read",
                self.unfounded
            )
        })
    }

    /// How a file ends that was not closed as it should be.
    pub fn unfinished(&self) -> Option<String> {
        match (self.finished, self.indexed, self.torn) {
            (true, ..) => None,
            (false, true, torn) => Some(format!(
                "the index behind the data is damaged, {torn} bytes; no data are missing by that"
            )),
            (false, false, 0) => Some("not closed: the recorder was stopped, or still writes".into()),
            (false, false, torn) => Some(format!(
                "not closed: the recorder was stopped, or still writes; {torn} bytes at the end are no whole chunk, \
                 which is up to a second"
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
