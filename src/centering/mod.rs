//! Task 2: finds the apex, brings the beam onto it, and keeps it there.
//!
//! - [`core`]: a sample and the last pose in, a steering command out; pure.
//! - [`told`]: what goes in besides samples, and what comes out.
//! - [`sight`], [`lookout`]: what a sample says of the beam, and what is known of the mirror.
//! - [`stage`], [`trail`]: where the stage was sent, and whether it follows.
//! - [`lock`]: what the loop may claim of itself, and what it does next.
//! - [`controller`], [`tracking`]: the PI controller with its limits, and its feed-forward.
//! - [`guide`], [`search`]: where the stage goes while the apex is not in sight.
//! - [`tuning`]: how all this shall work.
//! - [`stability`]: whether gains and delay go together.
//! - [`task`]: the loop around it.

pub mod controller;
pub mod core;
pub mod guide;
pub mod lock;
pub mod lookout;
pub mod search;
pub mod sight;
pub mod stability;
pub mod stage;
pub mod task;
#[cfg(test)]
mod tests;
pub mod told;
pub mod tracking;
pub mod trail;
pub mod tuning;

pub use told::{LoopState, LoopView, Outcome, TimedPose};
pub use tuning::Tuning;

pub use self::core::Centering;
