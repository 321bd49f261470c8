//! [`PoseReport`](trifacet_core::estimation::PoseReport)s to UDP and TCP, and the client side of the same protocol.
//!
//! - [`frame`]: the 192 bytes of a pose frame; [`layout`] is its byte table; [`stamp`] makes one of a report.
//! - [`message`]: how messages follow each other on TCP, and how a reader finds them again after damage.
//! - [`descriptor`]: what the daemon says of itself in JSON: descriptor, heartbeat, answer, refusal.
//! - [`publisher`]: the fast side: makes every frame; [`target`] sends the datagrams ([`endian`]: in network order).
//! - [`subscription`]: who leases datagrams and until when; [`subscription_server`] is the task.
//! - [`tcp`]: the slow side: the TCP server. [`request`] is what its clients say, [`encoding`] the shape of what
//!   they get, [`query`] the answers in one line; [`held`] keeps the last pose for those who ask for it.
//! - [`client`]: reads all this back; [`columns`] names what is in a frame for JSON and CSV.
//!
//! `docs/stream.md` describes the stream for those who write a client of their own.

pub mod client;
pub mod columns;
pub mod descriptor;
pub mod encoding;
pub mod publisher;
pub mod query;
pub mod subscription;
pub mod subscription_server;
pub mod target;
pub mod tcp;

pub use publisher::{Outlets, Publisher, PublisherSettings, StreamId};
