//! Entries to messages, and back. Pure.

use std::borrow::Cow;
use std::sync::Arc;

use byteorder::LittleEndian;
use serde::Serialize;
use serde::de::DeserializeOwned;
use trifacet_core::estimation::EstimatorState;
use trifacet_core::signals::{Identity, Scan};
use trifacet_core::time::Mono;
use trifacet_core::utc::Reading;
use trifacet_wire::Status;

use super::message::{self, Time, Unknown};
use super::{Entry, Keyframe, Topic};
use crate::config::{CalibrationContext, ConfigError, Tables, parse};

/// The version of this program: the state of another one may have another form.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Keyframes after which configuration and source are written again: damage where they stand costs no more of the
/// replay than that.
pub(super) const AGAIN: u32 = 10;

/// Stands before each message: plain CDR, little-endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// What cannot be written. Nothing that happens; but no reason to end a measurement.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// No CDR.
    #[error("a message cannot be encoded: {0}")]
    Cdr(#[from] cdr_encoding::Error),
    /// No state.
    #[error("the state of the estimation cannot be encoded: {0}")]
    State(#[from] postcard::Error),
    /// No TOML.
    #[error("the configuration cannot be written: {0}")]
    Config(#[from] toml::ser::Error),
}

/// A message that makes no sense.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// Shorter than it must be, or not CDR of this byte order.
    #[error("the message on {topic} cannot be read: {reason}")]
    Cdr {
        /// Of which topic.
        topic: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// A number that means nothing.
    #[error("the message on {topic} cannot be understood: {unknown}")]
    Unknown {
        /// Of which topic.
        topic: &'static str,
        /// What.
        unknown: Unknown,
    },
    /// The configuration is not one of this program.
    #[error("the configuration in the recording cannot be used: {0}")]
    Config(ConfigError),
    /// A keyframe without a configuration before it.
    #[error("a keyframe comes before the configuration that it rests on")]
    Order,
    /// The state was written by another version. What the decoder knows of meaning and source still holds.
    #[error("the state was recorded by version {0}, and this is {VERSION}")]
    Version(String),
    /// The state is damaged.
    #[error("the state of the estimation cannot be read: {0}")]
    State(postcard::Error),
}

/// A message on its way to the file.
#[derive(Clone, Copy, Debug)]
pub struct Encoded<'a> {
    /// Where.
    pub topic: Topic,
    /// When, nanoseconds of UTC since 1970.
    pub time_ns: i64,
    /// The message.
    pub data: &'a [u8],
}

/// Turns entries into messages.
#[derive(Clone, Debug)]
pub struct Encoder {
    /// UTC minus monotonic time, by the last frame.
    offset_ns: i64,
    /// The last moment that was told.
    latest: Mono,
    context: Option<Arc<CalibrationContext>>,
    source: Option<Arc<Identity>>,
    /// Keyframes since those were forgotten.
    keyframes: u32,
    bytes: Vec<u8>,
}

impl Encoder {
    /// An encoder that knows the time by both clocks, until frames tell it better.
    pub fn new((latest, utc_ns): Reading) -> Self {
        let offset_ns = utc_ns - latest.0;
        Self { offset_ns, latest, context: None, source: None, keyframes: 0, bytes: Vec::new() }
    }

    /// The time by both clocks, for entries that come before the frame that tells it.
    pub fn clocks(&mut self, (time, utc_ns): Reading) {
        (self.offset_ns, self.latest) = (utc_ns - time.0, time);
    }

    /// A new file begins: configuration and source are written again.
    pub fn restart(&mut self) {
        (self.context, self.source, self.keyframes) = (None, None, 0);
    }

    /// UTC of the last moment that was told, nanoseconds since 1970.
    pub fn now_ns(&self) -> i64 {
        self.latest.0 + self.offset_ns
    }

    /// Gives the messages of an entry, in order.
    ///
    /// # Errors
    /// What cannot be encoded, and whatever `put` says.
    pub fn encode<E: From<EncodeError>>(
        &mut self,
        entry: &Entry,
        mut put: impl FnMut(Encoded<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        match entry {
            Entry::Keyframe(keyframe) => self.keyframe(keyframe, &mut put),
            Entry::Sample { scan, sample, steering } => {
                let stamp = self.at(scan.time);
                self.put(Topic::Sample, &message::Sample::new(stamp, scan, sample, steering), put)
            }
            Entry::Silence { time, steering, why } => {
                let message = message::Silence::new(self.at(*time), *time, steering, why.as_deref());
                self.put(Topic::Silence, &message, put)
            }
            Entry::Frame { frame, time, covariance } => {
                self.offset_ns = frame.time_ns - time.0;
                self.at(*time);
                self.put(Topic::Frame, &message::Frame::new(frame, *time), &mut put)?;
                match covariance {
                    Some(covariance) if frame.status.has(Status::POSE_VALID) => {
                        self.put(Topic::Pose, &message::PoseStamped::new(frame, covariance), put)
                    }
                    _ => Ok(()),
                }
            }
            Entry::Lock { time, before, after, cause } => {
                let message = message::Lock::new(self.at(*time), *time, [*before, *after], cause);
                self.put(Topic::Lock, &message, put)
            }
        }
    }

    /// Gives the message that says what is missing here.
    ///
    /// # Errors
    /// As [`Encoder::encode`].
    pub fn gap<E: From<EncodeError>>(
        &mut self,
        entries: u64,
        reason: &str,
        put: impl FnMut(Encoded<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let gap = message::Gap { stamp: Time::new(self.now_ns()), entries, reason: reason.to_owned() };
        self.put(Topic::Gap, &gap, put)
    }

    fn keyframe<E: From<EncodeError>>(
        &mut self,
        keyframe: &Keyframe,
        put: &mut impl FnMut(Encoded<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        if self.keyframes == AGAIN {
            self.restart();
        }
        self.keyframes += 1;
        let Keyframe { context, source, last, memory } = keyframe;
        let stamp = last.map_or(Time::new(self.now_ns()), |last| self.at(last.time));
        if self.context.as_ref().is_none_or(|known| !Arc::ptr_eq(known, context)) {
            self.put(Topic::Config, &config(stamp, context).map_err(EncodeError::from)?, &mut *put)?;
            self.context = Some(Arc::clone(context));
        }
        if let Some(source) = source
            && self.source.as_ref().is_none_or(|known| !Arc::ptr_eq(known, source))
        {
            self.put(Topic::Source, &message::Source::new(stamp, source), &mut *put)?;
            self.source = Some(Arc::clone(source));
        }
        let state = postcard::to_stdvec(&(last, memory)).map_err(EncodeError::from)?;
        let source = source.is_some();
        let message = message::Keyframe { stamp, version: VERSION.to_owned(), source, state };
        self.put(Topic::Keyframe, &message, put)
    }

    /// The stamp of a moment.
    fn at(&mut self, time: Mono) -> Time {
        self.latest = time;
        Time::new(self.now_ns())
    }

    fn put<E: From<EncodeError>>(
        &mut self,
        topic: Topic,
        message: &impl Serialize,
        mut put: impl FnMut(Encoded<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let time_ns = self.now_ns();
        self.bytes.clear();
        self.bytes.extend(ENCAPSULATION);
        cdr_encoding::to_writer::<_, LittleEndian, _>(&mut self.bytes, message).map_err(EncodeError::from)?;
        put(Encoded { topic, time_ns, data: &self.bytes })
    }
}

fn config(stamp: Time, context: &CalibrationContext) -> Result<message::Config, toml::ser::Error> {
    let [a, b, c] = context.tables.0.clone().map(Option::unwrap_or_default);
    Ok(message::Config {
        stamp,
        version: VERSION.to_owned(),
        id: context.id(),
        toml: context.config.to_text()?,
        tables: (a, b, c),
    })
}

/// Turns messages into entries, in the order of the file.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    context: Option<Arc<CalibrationContext>>,
    source: Option<Arc<Identity>>,
}

impl Decoder {
    /// The last configuration that was read.
    pub fn context(&self) -> Option<&Arc<CalibrationContext>> {
        self.context.as_ref()
    }

    /// The last source that was read.
    pub fn source(&self) -> Option<&Arc<Identity>> {
        self.source.as_ref()
    }

    /// Configuration and source are not those in force: keyframes make no sense before they come again.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Takes the next message; gives an entry, if it is one by itself. Of a frame, the covariance is not
    /// restored: a replay computes it again.
    ///
    /// # Errors
    /// The message makes no sense. Those after it may.
    pub fn decode(&mut self, topic: Topic, data: &[u8]) -> Result<Option<Entry>, DecodeError> {
        let unknown = |unknown| DecodeError::Unknown { topic: topic.name(), unknown };
        Ok(match topic {
            Topic::Pose | Topic::Gap => None,
            Topic::Frame => {
                let (frame, time) = read::<message::Frame>(topic, data)?.read().map_err(unknown)?;
                Some(Entry::Frame { frame, time, covariance: None })
            }
            Topic::Sample => {
                let message = read::<message::Sample>(topic, data)?;
                let (scan, sample, steering) = message.read().map_err(unknown)?;
                Some(Entry::Sample { scan, sample, steering })
            }
            Topic::Silence => {
                let message = read::<message::Silence>(topic, data)?;
                let (time, steering, why) = message.read().map_err(unknown)?;
                Some(Entry::Silence { time, steering, why })
            }
            Topic::Lock => {
                let (time, [before, after], cause) =
                    read::<message::Lock>(topic, data)?.read().map_err(unknown)?;
                Some(Entry::Lock { time, before, after, cause: Cow::Owned(cause) })
            }
            Topic::Config => {
                self.context = None;
                self.context = Some(Arc::new(context(read(topic, data)?)?));
                None
            }
            Topic::Source => {
                self.source = Some(Arc::new(read::<message::Source>(topic, data)?.read()));
                None
            }
            Topic::Keyframe => Some(Entry::Keyframe(Box::new(self.keyframe(read(topic, data)?)?))),
        })
    }

    fn keyframe(&self, message: message::Keyframe) -> Result<Keyframe, DecodeError> {
        let context = self.context.clone().ok_or(DecodeError::Order)?;
        let source = self.source.clone().filter(|_| message.source);
        if message.version != VERSION {
            return Err(DecodeError::Version(message.version));
        }
        let (last, memory): (Option<Scan>, EstimatorState) =
            postcard::from_bytes(&message.state).map_err(DecodeError::State)?;
        Ok(Keyframe { context, source, last, memory })
    }
}

fn context(message: message::Config) -> Result<CalibrationContext, DecodeError> {
    let config = parse(&message.toml, None).map_err(DecodeError::Config)?;
    let (a, b, c) = message.tables;
    let tables = Tables([a, b, c].map(|table| (!table.is_empty()).then_some(table)));
    Ok(CalibrationContext { config, tables })
}

/// The message in these bytes.
///
/// # Errors
/// It is another one.
pub fn read<T: DeserializeOwned>(topic: Topic, data: &[u8]) -> Result<T, DecodeError> {
    let bad = |reason: String| DecodeError::Cdr { topic: topic.name(), reason };
    let body = data.strip_prefix(&ENCAPSULATION).ok_or_else(|| bad("it is not little-endian CDR".into()))?;
    let (message, used) =
        cdr_encoding::from_bytes::<T, LittleEndian>(body).map_err(|e| bad(e.to_string()))?;
    if used < body.len() { Err(bad(format!("{} bytes too many", body.len() - used))) } else { Ok(message) }
}

#[cfg(test)]
mod tests;
