//! The protocol of the acquisition board (`docs/board-protocol.md`), for both sides of the cable.
//!
//! - [`framing`]: from the byte stream to checked messages. [`message`]: their contents.
//! - [`identity`]: the identity of a board. [`bandwidth`]: the required data rate of the line.

pub mod bandwidth;
mod error;
mod fields;
pub mod framing;
pub mod identity;
pub mod message;

pub use bandwidth::required_baud;
pub use error::{MessageError, VERSION};
pub use framing::{Corrupted, Deframer};
pub use identity::BoardIdentity;
pub use message::{Answer, Request};
