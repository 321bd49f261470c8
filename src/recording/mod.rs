//! The record of what went in and what came out, so that a measurement can be replayed.
//!
//! - [`entry`]: what is recorded, as the fast side hands it over without ever waiting.
//! - [`witness`]: what estimation says for the record, with a keyframe every second.

pub mod entry;
pub mod witness;

pub use entry::{Entry, Keyframe, Tap};
pub use witness::Witness;
