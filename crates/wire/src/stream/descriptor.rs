//! Messages in JSON: descriptor, heartbeat, event, answer and refusal.
//!
//! Readers ignore unknown keys; a later minor version may add some.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::layout::Field;

/// The first message of every TCP stream: all that is needed to interpret the frames that follow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Descriptor {
    /// Version of the stream, "major.minor".
    pub stream_version: String,
    /// Version of the daemon.
    pub daemon_version: String,
    /// As in every frame: random number, drawn at the start of the daemon.
    pub session: u32,
    /// As in every frame: hash of geometry and calibration.
    pub config: u32,
    /// Frames per second.
    pub rate_hz: f64,
    /// Number of samples averaged into a frame.
    pub average: u16,
    /// Delay of an averaged frame, seconds: the time from the mean of its sample times to its last sample,
    /// half the length of the block. The time of a frame is the mean of the times of its samples.
    pub group_delay_s: f64,
    /// The sensor model: "ray" or "gaussian".
    pub model: String,
    /// Whether a valid calibration record belongs to the configuration; if not, frames carry `UNCALIBRATED`.
    pub calibrated: bool,
    /// Why `calibrated` is false; absent if it is true.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncalibrated: Option<String>,
    /// The calibration record of the configuration, valid or not; absent without a record.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationEntry>,
    /// The part of the stated standard uncertainties that averaging does not reduce and that is the same at every pose, in
    /// the sensor's world frame: x, y, z in metres; roll, pitch, yaw in radians. The text formats carry the whole
    /// systematic part of each pose.
    #[serde(default)]
    pub systematic: [f64; 6],
    /// Which standard uncertainties binary frames carry: "total", or "random" for the part that averaging reduces. Text
    /// formats carry the total.
    #[serde(default = "total")]
    pub deviations: String,
    /// Units of lengths, angles, powers and times.
    pub units: BTreeMap<String, String>,
    /// Description of the coordinate frames.
    pub coordinates: BTreeMap<String, String>,
    /// Definition of the rotation by the three angles.
    pub euler: String,
    /// Names of the status bits, from bit 0.
    pub status_bits: Vec<String>,
    /// Names of the lock states, from 0.
    pub lock_states: Vec<String>,
    /// The byte table of the pose frame.
    pub fields: Vec<FieldEntry>,
    /// The names of a frame's values in text formats (JSON, CSV).
    pub columns: Vec<String>,
    /// The replayed recording; absent if the samples come from a source.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub replay: Option<Replayed>,
    /// The stream of this client; absent if the client has not requested one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stream: Option<StreamForm>,
}

fn total() -> String {
    "total".to_owned()
}

/// What a calibration record states.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationEntry {
    /// Time of the calibration, RFC 3339.
    pub date: String,
    /// What was measured.
    pub method: String,
    /// Range for which the uncertainty holds, to both sides of the tare pose: of translations in metres, of rotations
    /// in radians.
    pub range: [f64; 2],
    /// Standard uncertainty of a pose relative to the tare pose by the calibration: x, y, z in metres; roll, pitch, yaw
    /// in radians.
    pub uncertainty: [f64; 6],
    /// Time from which the calibration is no longer valid, RFC 3339; absent without a limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires: Option<String>,
}

/// The recording that a daemon replays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replayed {
    /// Name of the file.
    pub file: String,
    /// UTC of its first frame, in RFC 3339 format.
    pub recorded: String,
    /// Speed of the replay relative to the recording.
    pub speed: f64,
    /// Whether the replay starts again at the end.
    pub repeat: bool,
}

/// The stream of one client, as requested and sent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StreamForm {
    /// "binary", "json" or "csv".
    pub format: String,
    /// Frames whose sequence number is divisible by this are sent.
    pub divider: u32,
    /// Frames per second.
    pub rate_hz: f64,
    /// Whether a frame without a valid pose carries the last valid one, marked with `POSE_HELD`.
    pub held: bool,
    /// Whether changes of the lock state are sent as events.
    #[serde(default)]
    pub events: bool,
    /// The values of a line of text, in order; empty with the binary format.
    pub columns: Vec<String>,
}

/// Sent once a second on every TCP connection.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Heartbeat {
    /// Frames sent to this client.
    pub sent: u64,
    /// Frames dropped for this client because it did not keep up.
    pub dropped: u64,
    /// Every counter of the daemon by name.
    pub counters: BTreeMap<String, u64>,
    /// The lock state with its cause; absent if the newest frame shows another state, or if no loop runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lock: Option<LockEvent>,
}

/// The lock state with its cause: an event of a stream that requests events.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockEvent {
    /// Changes of the lock state since the start of the daemon. A step of more than one shows changes that
    /// were not sent.
    pub number: u64,
    /// The lock state before the last change.
    pub from: String,
    /// The lock state.
    pub lock: String,
    /// The label of the cause, as in `/metrics`: "no_light".
    pub cause: String,
    /// The cause as a clause: "no PSD sees light".
    pub text: String,
    /// Time of the last change, UTC in RFC 3339 format.
    pub since: String,
}

/// The answer to a query: a message within a stream, or a line for a client without a stream.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Answer(pub String);

/// The reason why the daemon closes a connection.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    /// The reason, in readable form.
    pub error: String,
}

/// One field of the byte table, as sent in a descriptor.
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
