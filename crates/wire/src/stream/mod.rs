//! The stream beyond the pose frame: messages in JSON, and requests of clients (`docs/stream.md`).
//!
//! - [`message`]: messages in a byte stream, with resynchronisation after damage.
//! - [`descriptor`]: descriptor, heartbeat, event, answer and refusal.
//! - [`lines`], [`request`]: lines from a TCP client. [`subscription`]: datagrams under a lease.

pub mod descriptor;
pub mod lines;
pub mod message;
pub mod request;
pub mod subscription;

pub use descriptor::{
    Answer, CalibrationEntry, Descriptor, FieldEntry, Heartbeat, LockEvent, Refusal, Replayed, StreamForm,
};
pub use message::{Decoder, Message, MessageError, json};
pub use request::{ClientCommand, CommandError, Format, Pace, StreamRequest};
pub use subscription::{Delivery, MAX_LEASE_S, SubscriptionError, SubscriptionRequest};
