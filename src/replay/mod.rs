//! The same samples through the same code, once more.
//!
//! - [`engine`]: what was on record goes in, reports come out; pure.
//! - [`read_ahead`]: files, read ahead.
//! - [`task`]: a daemon whose source is a recording. [`header`]: what that says before all; [`playback`]: its entries,
//!   as often as they are wanted; [`pace`]: when they are due; `player`: that they come then; [`republisher`]: what is told.
//! - [`comparison`]: whether they are what was published then, bit by bit, or by how much they differ.

pub mod comparison;
pub mod engine;
pub mod header;
pub mod pace;
pub mod playback;
mod player;
pub mod read_ahead;
pub mod republisher;
pub mod task;
#[cfg(test)]
mod tests;

pub use comparison::Comparison;
pub use engine::Engine;
pub use header::RecordingHeader;
