//! The same samples through the same code, once more.
//!
//! - [`engine`]: what was on record goes in, reports come out; pure.
//! - [`feed`]: files, read ahead.
//! - [`task`]: a daemon whose source is a recording.
//! - [`verdict`]: whether they are what was published then, bit by bit, or by how much they differ.

pub mod engine;
pub mod feed;
pub mod task;
#[cfg(test)]
mod tests;
pub mod verdict;

pub use engine::Engine;
pub use verdict::Verdict;
