//! The centering loop: finds the apex, moves the beam onto it, and keeps it there. Pure.
//!
//! - [`centering`]: the loop: a sample and the last pose in, a steering command out.
//! - [`params`]: gains, limits and times of the loop. `modes`: its modes.
//! - [`state`]: inputs besides samples, and outputs.
//! - [`observation`], [`apex_tracker`]: what a sample shows, and where the apex is.
//! - [`stage`], [`command_history`]: the commanded position of the stage, and whether the stage follows.
//! - [`unanswered`]: commands that the stage has not acknowledged. [`command_delay`]: the delay of the others.
//! - [`lock`]: the lock state and the next action.
//! - [`controller`], [`tracking`]: the PI controller with its limits, and the feed-forward.
//! - [`open_loop`], [`search`]: moves while the offset is unknown.
//! - [`stability`]: whether the closed loop is stable with given gains and delay.

pub mod apex_tracker;
#[allow(clippy::module_inception)] // the main type of the folder has its name
pub mod centering;
pub mod command_delay;
pub mod command_history;
pub mod controller;
pub mod lock;
mod modes;
pub mod observation;
pub mod open_loop;
pub mod params;
pub mod search;
pub mod stability;
pub mod stage;
pub mod state;
#[cfg(test)]
mod tests;
pub mod tracking;
pub mod unanswered;

pub use centering::Centering;
pub use command_delay::DelayDoubt;
pub use modes::{LoopMode, OnExit, Target};
pub use params::LoopParams;
pub use state::{LoopRefusal, LoopState, LoopView, Outcome, TimedPose};
pub use unanswered::CommandBacklog;
