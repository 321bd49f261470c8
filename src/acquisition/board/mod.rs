//! The host's side of the conversation with an acquisition board. Pure: bytes and times in, bytes and events out.
//!
//! The messages themselves are in [`trifacet_wire::board`]; [`Sequence`] finds what was lost on the way, and
//! [`Session`] leads the conversation.

mod compatibility;
mod link_faults;
mod sequence;
mod session;

pub use sequence::{Arrival, Sequence};
pub use session::{Session, Settings};
