//! Encodes entries as messages, and decodes them. Pure.

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
use crate::config::{
    CalibrationContext, CalibrationState, ConfigError, SharedSpread, Standing, Tables, parse,
};

/// Version of this program. The state of another version may have another format.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Keyframes after which configuration and source are written again. Damage to them then costs no more of the
/// replay than this.
pub(super) const AGAIN: u32 = 10;

/// Encapsulation header of each message: plain CDR, little-endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Why an entry cannot be encoded. Not expected to happen, and no reason to end a measurement.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// Encoding as CDR failed.
    #[error("a message cannot be encoded: {0}")]
    Cdr(#[from] cdr_encoding::Error),
    /// Encoding of the state failed.
    #[error("the state of the estimation cannot be encoded: {0}")]
    State(#[from] postcard::Error),
    /// Encoding as TOML failed.
    #[error("the configuration cannot be written: {0}")]
    Config(#[from] toml::ser::Error),
}

/// Why a message cannot be decoded.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// Too short, or not CDR of this byte order.
    #[error("the message on {topic} cannot be read: {reason}")]
    Cdr {
        /// Topic of the message.
        topic: &'static str,
        /// The error.
        reason: String,
    },
    /// A number without a meaning in its field.
    #[error("the message on {topic} has an invalid value: {unknown}")]
    Unknown {
        /// Topic of the message.
        topic: &'static str,
        /// The number.
        unknown: Unknown,
    },
    /// The configuration is not valid for this program.
    #[error("the configuration in the recording cannot be used: {0}")]
    Config(ConfigError),
    /// What is recorded of the calibration is damaged.
    #[error("the calibration in the recording cannot be read: {0}")]
    Calibration(String),
    /// A keyframe without a configuration before it.
    #[error("a keyframe comes before its configuration")]
    OutOfOrder,
    /// The state was written by another version. Configuration and source in the decoder stay valid.
    #[error("the state was recorded by version {0}, and this is {VERSION}")]
    Version(String),
    /// The state is damaged.
    #[error("the state of the estimation cannot be read: {0}")]
    State(postcard::Error),
}

/// An encoded message.
#[derive(Clone, Copy, Debug)]
pub struct Encoded<'a> {
    /// Its topic.
    pub topic: Topic,
    /// Its time, nanoseconds of UTC since 1970.
    pub time_ns: i64,
    /// Its bytes.
    pub data: &'a [u8],
}

/// Encodes entries as messages.
#[derive(Clone, Debug)]
pub struct Encoder {
    /// UTC minus monotonic time, from the last frame.
    offset_ns: i64,
    /// Time of the latest entry.
    latest: Mono,
    context: Option<Arc<CalibrationContext>>,
    source: Option<Arc<Identity>>,
    /// Keyframes since configuration and source were written.
    keyframes: u32,
    bytes: Vec<u8>,
}

impl Encoder {
    /// An encoder with a reading of both clocks, which is used until the first frame.
    pub fn new((latest, utc_ns): Reading) -> Self {
        let offset_ns = utc_ns - latest.0;
        Self { offset_ns, latest, context: None, source: None, keyframes: 0, bytes: Vec::new() }
    }

    /// Sets the reading of both clocks, for entries before the first frame.
    pub fn clocks(&mut self, (time, utc_ns): Reading) {
        (self.offset_ns, self.latest) = (utc_ns - time.0, time);
    }

    /// Prepares for a new file: configuration and source are written again.
    pub fn restart(&mut self) {
        (self.context, self.source, self.keyframes) = (None, None, 0);
    }

    /// Time of the latest entry in UTC, nanoseconds since 1970.
    pub fn now_ns(&self) -> i64 {
        self.latest.0 + self.offset_ns
    }

    /// Passes the messages of an entry to `put`, in order.
    ///
    /// # Errors
    /// The entry cannot be encoded, or `put` fails.
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

    /// Passes the message that entries are missing here to `put`.
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

    /// The UTC stamp of a monotonic time.
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
        calibration: serde_json::to_string(&context.calibration).unwrap_or_default(),
        spread: context.calibration.spread.as_ref().map(SharedSpread::to_bytes).unwrap_or_default(),
    })
}

/// Decodes messages to entries, in the order of the file.
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

    /// Discards configuration and source. Keyframes cannot be used until both are read again.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Decodes the next message. Returns an entry unless the message is only context for others. The
    /// covariance of a frame is not restored: a replay computes it again.
    ///
    /// # Errors
    /// The message is invalid. Later messages may be valid.
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
        let context = self.context.clone().ok_or(DecodeError::OutOfOrder)?;
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
    let spread = message.spread;
    let mut calibration: CalibrationState = match message.calibration.as_str() {
        // Versions without records: a head with three tables counted as calibrated.
        "" if tables.0.iter().all(Option::is_some) => {
            CalibrationState { standing: Standing::Valid, ..CalibrationState::default() }
        }
        "" => CalibrationState::default(),
        json => serde_json::from_str(json).map_err(|e| DecodeError::Calibration(e.to_string()))?,
    };
    if !spread.is_empty() {
        let usable = SharedSpread::from_bytes(&spread);
        let wrong = || DecodeError::Calibration("its covariance is not usable".into());
        calibration.spread = Some(usable.ok_or_else(wrong)?);
    }
    Ok(CalibrationContext { config, tables, calibration })
}

/// Decodes a message.
///
/// # Errors
/// The bytes are not a message of this type.
pub fn read<T: DeserializeOwned>(topic: Topic, data: &[u8]) -> Result<T, DecodeError> {
    let bad = |reason: String| DecodeError::Cdr { topic: topic.name(), reason };
    let body = data.strip_prefix(&ENCAPSULATION).ok_or_else(|| bad("not little-endian CDR".into()))?;
    let (message, used) =
        cdr_encoding::from_bytes::<T, LittleEndian>(body).map_err(|e| bad(e.to_string()))?;
    if used < body.len() { Err(bad(format!("{} bytes too many", body.len() - used))) } else { Ok(message) }
}

#[cfg(test)]
mod tests;
