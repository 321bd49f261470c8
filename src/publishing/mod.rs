//! Publishes pose reports over UDP and TCP.
//!
//! - [`publisher`]: the fast side. It makes every frame; [`udp`] sends the datagrams.
//! - [`subscription`]: leases of datagrams; [`subscription_server`] is the task that accepts the requests.
//! - [`tcp`]: the TCP server, on the slow side. [`encoding`] brings frames into the format that a client
//!   requested, [`query`] answers queries with one line.
//! - [`descriptor`]: the JSON descriptor of the daemon and the heartbeat.
//! - [`columns`]: names and SI values of a frame, for JSON and CSV.
//!
//! Frame layout, framing and requests are in [`trifacet_wire`]. `docs/stream.md` describes the stream for
//! authors of other clients.

pub mod columns;
pub mod descriptor;
pub mod encoding;
pub mod lock_event;
pub mod publisher;
pub mod query;
pub mod subscription;
pub mod subscription_server;
pub mod tcp;
pub mod udp;

pub use publisher::{Outlets, Publisher, StreamId};
