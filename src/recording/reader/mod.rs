//! Reads a file into entries and reports its damage. Damage costs the chunk that contains it. No input makes
//! the reader panic, or use more memory than the largest chunk.
//!
//! - [`parts`]: a file to chunks, skipping damage. [`chunk`]: decompression and checksum.
//! - `continuity`: whether each sample follows the one before. [`tally`]: counts of the contents.
//! - [`damage`]: descriptions of errors.

mod bytes;
pub mod chunk;
mod continuity;
pub mod damage;
pub mod parts;
pub mod tally;

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::Arc;

use bytes::Bytes;
use chunk::Chunk;
use continuity::Continuity;
pub use damage::{Damage, ReadError};
use parts::{Part, Parts};
pub use tally::{Gap, Tally};
use trifacet_core::signals::Identity;

use super::codec::{self, DecodeError, Decoder};
use super::{Entry, Topic, message};
use crate::config::CalibrationContext;

/// An item of a recording.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "entries are the rule")]
pub enum Read {
    /// A recorded entry.
    Entry(Entry),
    /// A keyframe with a state of another version. What follows can be computed, but not identically.
    Foreign {
        /// Configuration and tables from here on.
        context: Arc<CalibrationContext>,
        /// The source, if one was up.
        source: Option<Arc<Identity>>,
        /// Why the state cannot be read.
        why: String,
    },
    /// The recorder left out entries here.
    Gap {
        /// Number of entries; 0: unknown.
        entries: u64,
        /// Cause.
        reason: String,
    },
    /// A part that cannot be read.
    Damage(Damage),
}

/// Reads a file from start to end.
#[derive(Debug)]
pub struct Reader {
    parts: Parts,
    /// The current chunk, and the position in it.
    chunk: Option<(Chunk, usize)>,
    channels: Channels,
    sink: MessageSink,
}

/// The topics of the channels of a file.
#[derive(Debug, Default)]
struct Channels(BTreeMap<u16, Option<Topic>>);

/// Decodes messages and collects the results.
#[derive(Debug)]
struct MessageSink {
    decoder: Decoder,
    wanted: Vec<Topic>,
    ready: VecDeque<Read>,
    continuity: Continuity,
    tally: Tally,
}

impl Reader {
    /// All topics that a replay needs.
    pub const REPLAY: &'static [Topic] = &[
        Topic::Frame,
        Topic::Sample,
        Topic::Silence,
        Topic::Lock,
        Topic::Config,
        Topic::Source,
        Topic::Keyframe,
        Topic::Gap,
    ];

    /// Opens a file. Messages on topics that are not in `wanted` are counted, not decoded.
    ///
    /// # Errors
    /// The file cannot be read, or is not an MCAP file.
    pub fn open(path: &Path, wanted: &[Topic]) -> Result<Self, ReadError> {
        let parts = Parts::open(path)?;
        let tally = Tally { size: parts.size(), ..Tally::default() };
        let (decoder, ready, continuity) = <(Decoder, VecDeque<Read>, Continuity)>::default();
        let sink = MessageSink { decoder, wanted: wanted.to_vec(), ready, continuity, tally };
        Ok(Self { parts, chunk: None, channels: Channels::default(), sink })
    }

    /// Counts of what was read so far.
    pub fn tally(&self) -> &Tally {
        &self.sink.tally
    }

    /// Position in the file, bytes.
    pub fn at(&self) -> u64 {
        self.parts.at()
    }

    /// The next item of the file; `None` at its end.
    ///
    /// # Errors
    /// The system reports an error.
    pub fn read(&mut self) -> Result<Option<Read>, ReadError> {
        loop {
            if let Some(read) = self.sink.ready.pop_front() {
                return Ok(Some(read));
            }
            if let Some((chunk, from)) = self.chunk.take() {
                let (at, sink) = (self.parts.at(), &mut self.sink);
                let mut records = chunk.records(from);
                let whole = self.channels.message(&mut records, |topic, time_ns, data| {
                    sink.message(topic, time_ns, data, at);
                });
                if whole.is_some() && !records.0.is_empty() {
                    let from = chunk.size() - records.0.len();
                    self.chunk = Some((chunk, from));
                }
                self.badly_written(whole);
                continue;
            }
            let Some(part) = self.part()? else { return Ok(None) };
            match part {
                Part::Chunk(chunk) if chunk.size() == 0 => {}
                Part::Chunk(chunk) => self.chunk = Some((chunk, 0)),
                Part::Damage(damage) => self.sink.damaged(damage),
            }
        }
    }

    /// Passes the messages of the next part to `put` without decoding. Returns false at the end of the file.
    ///
    /// # Errors
    /// The system reports an error.
    pub fn raw(&mut self, mut put: impl FnMut(Topic, i64, &[u8])) -> Result<bool, ReadError> {
        let Some(part) = self.part()? else { return Ok(false) };
        match part {
            Part::Chunk(chunk) => {
                let tally = &mut self.sink.tally;
                let mut records = chunk.records(0);
                let mut whole = Some(());
                while whole.is_some() && !records.0.is_empty() {
                    whole = self.channels.message(&mut records, |topic, time_ns, data| {
                        tally.message(topic, time_ns);
                        if let Some(topic) = topic {
                            put(topic, time_ns, data);
                        }
                    });
                }
                self.badly_written(whole);
            }
            Part::Damage(damage) => self.sink.damaged(damage),
        }
        Ok(true)
    }

    fn part(&mut self) -> Result<Option<Part>, ReadError> {
        let part = self.parts.take()?;
        if part.is_none() {
            let Parts { finished, indexed, torn, .. } = self.parts;
            let tally = &mut self.sink.tally;
            (tally.finished, tally.indexed, tally.torn) = (finished, indexed, torn);
        }
        Ok(part)
    }

    fn badly_written(&mut self, whole: Option<()>) {
        if whole.is_none() {
            let what = "the previous chunk is malformed".into();
            self.sink.damaged(Damage { at: self.parts.at(), bytes: 0, what });
        }
    }
}

impl Channels {
    /// Reads the next record of a chunk. Passes messages to `put`, with their topic if it is known. Returns
    /// `None` if the chunk breaks off.
    fn message(
        &mut self,
        records: &mut Bytes<'_>,
        put: impl FnOnce(Option<Topic>, i64, &[u8]),
    ) -> Option<()> {
        let (opcode, body) = records.record()?;
        let mut body = Bytes(body);
        match opcode {
            4 => {
                let (id, _schema) = (body.u16()?, body.u16()?);
                let (topic, encoding) = (body.text()?, body.text()?);
                self.0.insert(id, Topic::of(topic).filter(|_| encoding == "cdr"));
            }
            5 => {
                let (id, _sequence) = (body.u16()?, body.u32()?);
                let (log_time, _publish_time) = (body.u64()?, body.u64()?);
                put(self.topic(id), log_time as i64, body.0);
            }
            _ => {}
        }
        Some(())
    }

    /// The first chunk defines the channels. If it is damaged, the ids that this program assigns are used.
    fn topic(&self, id: u16) -> Option<Topic> {
        let usual = || Topic::ALL.get(usize::from(id).checked_sub(1)?).copied();
        self.0.get(&id).copied().unwrap_or_else(|| if self.0.is_empty() { usual() } else { None })
    }
}

impl MessageSink {
    fn damaged(&mut self, damage: Damage) {
        self.continuity.hole();
        self.tally.damages.push(damage.clone());
        self.ready.push_back(Read::Damage(damage));
    }

    fn message(&mut self, topic: Option<Topic>, time_ns: i64, data: &[u8], at: u64) {
        self.tally.message(topic, time_ns);
        let Some(topic) = topic.filter(|topic| self.wanted.contains(topic)) else { return };
        if let Err(error) = self.decode(topic, data, at) {
            let what = format!("in the previous chunk, {error}");
            self.damaged(Damage { at, bytes: 0, what });
        }
    }

    fn decode(&mut self, topic: Topic, data: &[u8], at: u64) -> Result<(), DecodeError> {
        if topic == Topic::Gap {
            let message::Gap { entries, reason, .. } = codec::read(topic, data)?;
            self.continuity.gap(entries);
            self.tally.gaps.push(Gap { entries, reason: reason.clone() });
            self.ready.push_back(Read::Gap { entries, reason });
            return Ok(());
        }
        match self.decoder.decode(topic, data) {
            Ok(Some(entry)) => {
                self.tally.entry(&entry);
                if let Some(what) = self.continuity.wrong(&entry) {
                    if matches!(entry, Entry::Frame { .. }) {
                        self.decoder.forget();
                    }
                    self.damaged(Damage { at, bytes: 0, what });
                }
                self.continuity.take(&entry);
                self.ready.push_back(Read::Entry(entry));
            }
            Ok(None) => {}
            Err(error @ DecodeError::Version(_)) => {
                let context = self.decoder.context().cloned().ok_or(DecodeError::OutOfOrder)?;
                let source = self.decoder.source().cloned();
                self.tally.config(&context);
                self.ready.push_back(Read::Foreign { context, source, why: error.to_string() });
            }
            // The configuration was in a part already reported as damaged; this part is intact.
            Err(DecodeError::OutOfOrder) if self.tally.incomplete() => self.tally.unfounded += 1,
            Err(error) => return Err(error),
        }
        Ok(())
    }
}
