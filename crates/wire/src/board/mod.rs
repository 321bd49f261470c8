//! The protocol of the acquisition board (`docs/board-protocol.md`), for both sides of the cable.
//!
//! - [`framing`]: from the byte stream to checked messages. [`message`]: their contents. [`scan`]: a scan.
//! - [`identity`]: the identity of a board. [`unit`](mod@unit): units of its
//!   channels. [`bandwidth`]: the required data rate of the line.

pub mod bandwidth;
mod error;
mod fields;
pub mod framing;
pub mod identity;
pub mod message;
pub mod scan;
pub mod unit;

pub use bandwidth::required_baud;
pub use error::{MINOR, MessageError, VERSION};
pub use framing::{Corrupted, Deframer};
pub use identity::{BoardIdentity, Extension};
pub use message::{Answer, Request};
pub use scan::{BoardScan, ScanFormat};
pub use unit::{ChannelUnit, Unit};
