//! Task 2: keeps the beam on the apex.
//!
//! - [`core`]: a sample and the last pose in, a steering command out; pure.
//! - [`controller`]: the PI controller with its limits.
//! - [`lock`]: what the loop may claim of itself.
//! - [`task`]: the loop around it.

pub mod controller;
pub mod core;
pub mod lock;
pub mod task;
pub mod tracking;
#[cfg(test)]
mod tests;

pub use self::core::{Centering, LoopState, LoopView, Tuning};
pub use lock::LockState;
