//! Task 1: raw codes to [`Sample`](trifacet_core::signals::Sample)s.
//!
//! A [`Source`] (the twin or a serial board) delivers [`Scan`](trifacet_core::signals::Scan)s of raw converter codes; the channel
//! map turns each into a sample in metres and watts. The steering command goes back the same way.

pub mod board;
pub mod port;
pub mod serial;
pub mod source;
pub mod task;
pub mod timebase;

pub use serial::SerialSource;
pub use source::{Source, SourceError, SourceEvent};
