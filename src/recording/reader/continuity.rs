//! Whether one entry on record follows the other.

use trifacet_core::signals::Sample;

use crate::recording::Entry;

/// Counts the samples along, to find a hole that nothing on record tells of: a file that was cut, or put together.
#[derive(Debug, Default)]
pub(super) struct Continuity {
    /// Index of the sample before, where that is known.
    last: Option<u64>,
    /// Index of the last sample at all: no later one has a smaller.
    newest: Option<u64>,
    /// The recorder was behind, and said so: what it left out stands further on, in several places.
    behind: bool,
    /// The configuration in force may have changed in a hole.
    doubt: bool,
    /// The one that was taken nevertheless, until a frame says that it is the right one.
    taken: Option<u32>,
}

impl Continuity {
    /// Something is missing just here, and that is told.
    pub(super) fn hole(&mut self) {
        (self.last, self.doubt, self.taken) = (None, true, None);
    }

    /// The recorder had to leave something out.
    pub(super) fn gap(&mut self, entries: u64) {
        self.hole();
        self.behind |= entries > 0;
    }

    /// What is wrong between the entry before and this one.
    pub(super) fn wrong(&self, entry: &Entry) -> Option<String> {
        if let Entry::Frame { frame, .. } = entry
            && self.taken.is_some_and(|taken| taken != frame.config)
        {
            return Some("the configuration has changed in a place that cannot be read".into());
        }
        if let Entry::Sample { sample, .. } = entry
            && let Some(newest) = self.newest.filter(|newest| sample.index <= *newest)
        {
            return Some(wrong(newest, sample));
        }
        let last = self.last.filter(|_| !self.behind)?;
        match entry {
            Entry::Sample { sample, .. } if !sample.follows(last) => Some(wrong(last, sample)),
            Entry::Keyframe(keyframe) => {
                let before = keyframe.last.filter(|before| before.index != last)?;
                Some(format!(
                    "a keyframe behind sample {} follows sample {last}, and nothing on record says why",
                    before.index
                ))
            }
            _ => None,
        }
    }

    /// Goes on behind this entry.
    pub(super) fn take(&mut self, entry: &Entry) {
        match entry {
            Entry::Sample { sample, .. } => {
                (self.last, self.newest) = (Some(sample.index), Some(sample.index));
            }
            Entry::Keyframe(keyframe) => {
                self.last = keyframe.last.map(|scan| scan.index);
                self.taken = self.doubt.then(|| keyframe.context.id());
            }
            Entry::Frame { .. } => self.doubt &= self.taken.take().is_none(),
            Entry::Silence { .. } | Entry::Lock { .. } => {}
        }
    }
}

fn wrong(last: u64, sample: &Sample) -> String {
    let Sample { index, lost, .. } = sample;
    format!(
        "sample {index} follows sample {last}, with {lost} lost between them, and nothing on record says why"
    )
}
