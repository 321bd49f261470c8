//! The host side of the board protocol. Pure: bytes and times in, bytes and events out.
//!
//! The messages are in [`trifacet_wire::board`]. [`Sequence`] detects lost scans, and [`Session`] is the
//! state machine of the connection.

mod boot_watch;
mod compatibility;
mod foreign;
mod link_faults;
mod sequence;
mod session;
mod settings;

pub use foreign::Foreign;
pub use sequence::{Arrival, Sequence};
pub use session::Session;
pub use settings::Settings;
