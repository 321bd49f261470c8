//! The language of the acquisition board (`docs/board-protocol.md`), for both sides of the cable.
//!
//! [`frame`] cuts the byte stream into checked messages, [`message`] gives them their meaning,
//! [`Sequence`] finds what was lost on the way, [`budget`] says how fast the wire has to be, and
//! [`Session`] is the host's whole side of the conversation. All of it is pure: bytes and times in,
//! bytes and events out.

pub mod budget;
mod fields;
mod fitness;
pub mod frame;
pub mod identity;
pub mod message;
mod sequence;
mod session;
mod tally;

pub use budget::required_baud;
pub use frame::{Corrupted, Deframer};
pub use identity::BoardIdentity;
pub use message::{Answer, MessageError, Request};
pub use sequence::{Arrival, Sequence};
pub use session::{Session, Settings};
