//! Answers to queries in one line of ASCII, `key=value` separated by spaces, for controllers that cannot
//! read binary data.

use std::fmt::Write as _;

use trifacet_core::centering::lock::{LockCause, LockCondition};
use trifacet_wire::layout::POSE;
use trifacet_wire::stream::Descriptor;
use trifacet_wire::{PoseFrame, Status};

use super::encoding::EncodedFrame;

/// A pose older than this, in seconds, and older than three frames is reported as invalid: the daemon stalls.
const STALE_S: f64 = 1.0;

/// Answer to `pose?`: the newest pose.
pub fn pose(encoded: &EncodedFrame, frames_hz: f64, lock: Option<LockCondition>) -> String {
    let frame = encoded.frame();
    let age_s = encoded.age_s();
    let valid = valid(frame, age_s, frames_hz);
    let mut line = format!("valid={}", u8::from(valid));
    for (name, x) in POSE.iter().zip(frame.pose) {
        // Seventeen digits reproduce a 64-bit number exactly.
        let _ = if valid { write!(line, " {name}={x:.16e}") } else { write!(line, " {name}=nan") };
    }
    line + &state(frame, age_s) + &cause(lock)
}

/// Answer to `status?`: the newest status.
pub fn status(encoded: &EncodedFrame, frames_hz: f64, lock: Option<LockCondition>) -> String {
    let (frame, age_s) = (encoded.frame(), encoded.age_s());
    let names: Vec<_> = frame.status.names().collect();
    let names = if names.is_empty() { "none".into() } else { names.join(",") };
    format!(
        "valid={}{} bits={names} session=0x{:08x} config=0x{:08x} rate_hz={frames_hz}{}",
        u8::from(valid(frame, age_s, frames_hz)),
        state(frame, age_s),
        frame.session,
        frame.config,
        cause(lock)
    )
}

/// Answer to `descriptor?`: the descriptor of the daemon.
///
/// # Errors
/// The descriptor cannot be serialized.
pub fn descriptor(descriptor: &Descriptor) -> serde_json::Result<Vec<u8>> {
    Ok(format!("{{\"descriptor\":{}}}\n", serde_json::to_string(descriptor)?).into_bytes())
}

/// Validity at this age. The answer states the same age, so that the two never contradict each other.
fn valid(frame: &PoseFrame, age_s: f64, frames_hz: f64) -> bool {
    frame.status.has(Status::POSE_VALID) && age_s <= STALE_S.max(3.0 / frames_hz)
}

fn state(frame: &PoseFrame, age_s: f64) -> String {
    let PoseFrame { lock, status, sequence, .. } = frame;
    format!(" lock={} status=0x{:08x} age_s={age_s:.6} sequence={sequence}", lock.name(), status.0)
}

/// The cause of the lock state, as in `/metrics`; "unknown" if none explains the frame.
fn cause(lock: Option<LockCondition>) -> String {
    format!(" cause={}", lock.map_or("unknown", |condition| LockCause::label(condition.cause)))
}
