//! The same samples through the same code, once more.
//!
//! - [`engine`]: what was on record goes in, reports come out; pure.
//! - [`feed`]: files, read ahead.
//! - [`task`]: a daemon whose source is a recording. [`beginning`]: what that says before all; [`tape`]: its entries,
//!   as often as they are wanted; [`pace`]: when they are due; `player`: that they come then; [`teller`]: what is told.
//! - [`verdict`]: whether they are what was published then, bit by bit, or by how much they differ.

pub mod beginning;
pub mod engine;
pub mod feed;
pub mod pace;
mod player;
pub mod tape;
pub mod task;
pub mod teller;
#[cfg(test)]
mod tests;
pub mod verdict;

pub use beginning::Beginning;
pub use engine::Engine;
pub use verdict::Verdict;
