//! What the daemon says of itself, in JSON.
//!
//! Readers ignore keys that they do not know: a later minor version may add some.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::layout::Field;

/// The first message of every TCP stream: all that is needed to read the frames that follow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Descriptor {
    /// Version of the stream, "major.minor".
    pub stream_version: String,
    /// Version of the daemon.
    pub daemon_version: String,
    /// As in every frame: random at the daemon's start.
    pub session: u32,
    /// As in every frame: hash of geometry and calibration.
    pub config: u32,
    /// Frames a second.
    pub rate_hz: f64,
    /// Samples averaged into a frame.
    pub average: u16,
    /// How much older a frame's time is than its last sample: half the block of an average. The time
    /// of a frame already is the mean of its samples' times.
    pub group_delay_s: f64,
    /// The sensor model: "ray" or "gaussian".
    pub model: String,
    /// Whether every PSD has a correction table; if not, frames carry `UNCALIBRATED`.
    pub calibrated: bool,
    /// Lengths, angles, powers and times are in these units.
    pub units: BTreeMap<String, String>,
    /// The coordinate frames in words.
    pub coordinates: BTreeMap<String, String>,
    /// How the three angles make a rotation.
    pub euler: String,
    /// Names of the status bits, from bit 0.
    pub status_bits: Vec<String>,
    /// Names of the lock states, from 0.
    pub lock_states: Vec<String>,
    /// The byte table of the pose frame.
    pub fields: Vec<FieldEntry>,
    /// The names of a frame's values in text (JSON, CSV).
    pub columns: Vec<String>,
    /// The recording that is replayed; absent where the samples come from a source.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub replay: Option<Replayed>,
    /// What this client gets; absent where no stream was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stream: Option<StreamForm>,
}

/// The recording that a daemon replays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replayed {
    /// Name of the file.
    pub file: String,
    /// UTC of its first frame, as RFC 3339 has it.
    pub recorded: String,
    /// So many times as fast as it was recorded.
    pub speed: f64,
    /// Whether it begins again at its end.
    pub repeat: bool,
}

/// The stream of one client, as it was asked for and is sent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StreamForm {
    /// "binary", "json" or "csv".
    pub format: String,
    /// Frames whose sequence this divides are sent.
    pub divider: u32,
    /// So many a second.
    pub rate_hz: f64,
    /// Whether the last valid pose stays, marked with `POSE_HELD`.
    pub held: bool,
    /// The values of a line of text, in order; empty in binary.
    pub columns: Vec<String>,
}

/// Once a second on every TCP connection.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Heartbeat {
    /// Frames sent to this client.
    pub sent: u64,
    /// Frames dropped for this client because it did not keep up.
    pub dropped: u64,
    /// Every counter of the daemon by name.
    pub counters: BTreeMap<String, u64>,
}

/// The answer to a query, within a stream; the line that a client without a stream gets.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Answer(pub String);

/// Why the daemon ends a connection.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    /// The reason, for people.
    pub error: String,
}

/// One field of the byte table, as a client reads it from a descriptor.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct FieldEntry {
    /// Name.
    pub name: String,
    /// First byte.
    pub offset: u16,
    /// Type of an element.
    #[serde(rename = "type")]
    pub kind: String,
    /// Number of elements.
    pub count: u16,
    /// Unit of an element.
    pub unit: String,
}

impl From<&Field> for FieldEntry {
    fn from(f: &Field) -> Self {
        let &Field { name, offset, kind, count, unit } = f;
        Self { name: name.into(), offset, kind: kind.into(), count, unit: unit.into() }
    }
}
