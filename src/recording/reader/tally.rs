//! What a file holds.

use super::Damage;
use crate::config::Meaning;
use crate::recording::{Entry, Topic};

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
    /// What the recorder had to leave out, and why.
    pub gaps: Vec<(u64, String)>,
    /// What cannot be read.
    pub damages: Vec<Damage>,
    /// The file was closed as it should be.
    pub finished: bool,
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
        self.finished && self.damages.is_empty() && self.gaps.is_empty()
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
            Entry::Sample { sample, .. } => self.lost += u64::from(sample.lost),
            Entry::Lock { before, after, cause, .. } => {
                self.locks.push(format!("{} -> {}: {cause}", before.name(), after.name()));
            }
            Entry::Keyframe(keyframe) => self.config(&keyframe.meaning),
            Entry::Silence { .. } | Entry::Frame { .. } => {}
        }
    }

    pub(super) fn config(&mut self, meaning: &Meaning) {
        let id = meaning.id();
        if self.configs.last() != Some(&id) {
            self.configs.push(id);
        }
    }
}
