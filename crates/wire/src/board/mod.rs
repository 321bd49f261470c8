//! The protocol of the acquisition board (`docs/board-protocol.md`), for both sides of the cable.
//!
//! [`framing`] cuts the byte stream into checked messages, [`message`] gives them their meaning, [`bandwidth`]
//! says how fast the wire has to be.

pub mod bandwidth;
mod fields;
pub mod framing;
pub mod identity;
pub mod message;

pub use bandwidth::required_baud;
pub use framing::{Corrupted, Deframer};
pub use identity::BoardIdentity;
pub use message::{Answer, MessageError, Request};
