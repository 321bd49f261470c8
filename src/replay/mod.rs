//! Replays recordings: the recorded samples pass through the same code again.
//!
//! - [`engine`]: entries in, reports out; pure.
//! - [`read_ahead`]: reads files ahead in a thread.
//! - [`comparison`]: compares the reports with the recorded frames, bit by bit.
//! - [`task`]: the task of a daemon whose source is a recording.
//! - [`header`]: first configuration and first frame of a recording.
//! - [`playback`]: the entries of a recording, repeated if wanted.
//! - [`pace`]: converts recorded time to present time. `player`: processes entries when they are due.
//! - [`republisher`]: publishes the reports.

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
pub use player::Recording;
