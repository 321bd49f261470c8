//! The record of what went in and what came out, so that a measurement can be replayed.
//!
//! - [`entry`]: what is recorded, as the fast side hands it over without ever waiting.
//! - [`witness`]: what estimation says for the record, with a keyframe every second.
//! - [`schema`], [`message`]: topics and messages, as tools for ROS 2 know them. [`codec`]: entries to messages and back.
//! - [`writer`]: messages to a file.

pub mod codec;
pub mod entry;
pub mod message;
pub mod reader;
pub mod schema;
pub mod witness;
pub mod writer;

pub use entry::{Entry, Keyframe, Tap};
pub use reader::Reader;
pub use schema::Topic;
pub use witness::Witness;
