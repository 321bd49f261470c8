//! Checks whether each recorded entry follows the one before.

use trifacet_core::signals::Sample;

use crate::recording::Entry;

/// Follows the sample numbers to find gaps that the recording does not report, as in a file that was cut or
/// joined.
#[derive(Debug, Default)]
pub(super) struct Continuity {
    /// Index of the previous sample, if known.
    last: Option<u64>,
    /// Index of the last sample seen. Later indices must be greater.
    newest: Option<u64>,
    /// The recorder reported that it fell behind: further entries may be missing in several later places.
    behind: bool,
    /// The configuration may have changed in a gap.
    doubt: bool,
    /// The configuration assumed after a gap, until a frame confirms it.
    taken: Option<u32>,
}

impl Continuity {
    /// A reported gap: entries are missing here.
    pub(super) fn hole(&mut self) {
        (self.last, self.doubt, self.taken) = (None, true, None);
    }

    /// A gap reported by the recorder.
    pub(super) fn gap(&mut self, entries: u64) {
        self.hole();
        self.behind |= entries > 0;
    }

    /// The inconsistency between the previous entry and this one, if there is one.
    pub(super) fn wrong(&self, entry: &Entry) -> Option<String> {
        if let Entry::Frame { frame, .. } = entry
            && self.taken.is_some_and(|taken| taken != frame.config)
        {
            return Some("the configuration has changed in a part that cannot be read".into());
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
                    "a keyframe after sample {} follows sample {last}, with no reason on record",
                    before.index
                ))
            }
            _ => None,
        }
    }

    /// Continues with this entry.
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
        "sample {index} follows sample {last}, with {lost} lost between them, and with no reason on record"
    )
}
