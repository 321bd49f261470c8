//! The last seconds in memory, in compressed segments of about a second. Each segment begins at a keyframe.

use std::collections::VecDeque;

use trifacet_core::time::{Mono, NS_PER_S};

use super::codec::{Encoded, Encoder};
use super::writer::{RecordError, Writer};
use super::{Entry, Topic};

/// Memory limit in bytes. Beyond it the oldest segments are dropped.
const MOST: usize = 512 << 20;

/// The last seconds of entries.
pub struct Ring {
    keep_ns: i64,
    compression: Option<mcap::Compression>,
    done: VecDeque<Stretch>,
    open: Option<(i64, Writer<Vec<u8>>)>,
    bytes: usize,
}

/// The entries from one keyframe to the next.
struct Stretch {
    /// Start: nanoseconds of UTC since 1970.
    begin_ns: i64,
    /// End.
    end: Mono,
    file: Vec<u8>,
}

impl Ring {
    /// A ring that keeps the last `keep_s` seconds.
    pub fn new(keep_s: f64, compression: Option<mcap::Compression>) -> Self {
        let keep_ns = (keep_s * NS_PER_S as f64) as i64;
        Self { keep_ns, compression, done: VecDeque::new(), open: None, bytes: 0 }
    }

    /// Memory used by complete segments, bytes.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Start of the oldest segment: nanoseconds of UTC since 1970.
    pub fn begin_ns(&self) -> Option<i64> {
        let open = self.open.as_ref().map(|(begin_ns, _)| *begin_ns);
        self.done.front().map(|oldest| oldest.begin_ns).or(open)
    }

    /// Adds an entry. With `forget`, drops segments that are too old; not to be set while the ring is
    /// drained.
    ///
    /// # Errors
    /// The entry cannot be encoded.
    pub fn put(
        &mut self,
        encoder: &mut Encoder,
        entry: &Entry,
        now: Mono,
        forget: bool,
    ) -> Result<(), RecordError> {
        if matches!(entry, Entry::Keyframe(_)) {
            self.close(now)?;
            if forget {
                self.forget(now);
            }
            encoder.restart();
            self.open = Some((encoder.now_ns(), Writer::new(Vec::new(), self.compression)?));
        }
        let Some((_, writer)) = &mut self.open else { return Ok(()) };
        encoder.encode(entry, |message| writer.put(message).map_err(RecordError::from))
    }

    /// Adds the message that entries are missing before the next one.
    ///
    /// # Errors
    /// The message cannot be encoded.
    pub fn gap(&mut self, encoder: &mut Encoder, entries: u64, why: &str) -> Result<(), RecordError> {
        let Some((_, writer)) = &mut self.open else { return Ok(()) };
        encoder.gap(entries, why, |message| writer.put(message).map_err(RecordError::from))
    }

    /// Completes the open segment.
    ///
    /// # Errors
    /// The end of the segment cannot be encoded.
    pub fn close(&mut self, now: Mono) -> Result<(), RecordError> {
        if let Some((begin_ns, writer)) = self.open.take() {
            let file = writer.finish()?;
            self.bytes += file.len();
            self.done.push_back(Stretch { begin_ns, end: now, file });
        }
        Ok(())
    }

    fn forget(&mut self, now: Mono) {
        while let Some(oldest) = self.done.front()
            && (now - oldest.end > self.keep_ns || self.bytes > MOST)
        {
            self.pop();
        }
    }

    fn pop(&mut self) -> Option<Stretch> {
        let stretch = self.done.pop_front()?;
        self.bytes -= stretch.file.len();
        Some(stretch)
    }

    /// Drops all entries.
    pub fn clear(&mut self) {
        (self.open, self.bytes) = (None, 0);
        self.done.clear();
    }

    /// Passes the messages of the oldest segment to `put` and drops it. Returns false if there is no segment.
    ///
    /// # Errors
    /// `put` fails, or the segment cannot be read.
    pub fn drain(
        &mut self,
        mut put: impl FnMut(Encoded<'_>) -> Result<(), RecordError>,
    ) -> Result<bool, RecordError> {
        let Some(stretch) = self.pop() else { return Ok(false) };
        for message in mcap::MessageStream::new(&stretch.file)? {
            let message = message?;
            let Some(topic) = Topic::of(&message.channel.topic) else { continue };
            put(Encoded { topic, time_ns: message.log_time as i64, data: &message.data })?;
        }
        Ok(true)
    }
}
