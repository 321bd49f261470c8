//! Task 1: raw codes to [`Sample`]s.
//!
//! A [`Source`] (the twin or a serial board) delivers [`Scan`]s of raw converter codes; the channel
//! map turns each into a [`Sample`] in metres and watts. The steering command goes back the same way.

pub mod board;
pub mod channels;
pub mod correction;
pub mod dark;
pub mod port;
pub mod scan;
pub mod serial;
pub mod source;
pub mod task;
pub mod timebase;

pub use channels::{ChannelMap, Channels};
pub use scan::{Identity, PsdState, Sample, Scan};
pub use serial::SerialSource;
pub use source::{Down, Event, Source};
