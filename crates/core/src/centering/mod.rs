//! Centering: finds the apex, brings the beam onto it, and keeps it there. Pure.
//!
//! - [`centering`]: a sample and the last pose in, a steering command out.
//! - [`params`]: gains, limits and times of the loop. [`modes`]: what the loop does.
//! - [`state`]: what goes in besides samples, and what comes out.
//! - [`observation`], [`apex_tracker`]: where a sample shows the beam, and where the apex is.
//! - [`stage`], [`command_history`]: where the stage was commanded to, and whether it follows.
//! - [`lock`]: the lock state and the next action.
//! - [`controller`], [`tracking`]: the PI controller with its limits, and its feed-forward.
//! - [`open_loop`], [`search`]: moves while the offset is unknown.
//! - [`stability`]: whether the closed loop is stable with given gains and delay.

pub mod apex_tracker;
#[allow(clippy::module_inception)] // the loop has the name of its folder
pub mod centering;
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

pub use centering::Centering;
pub use modes::{LoopMode, OnExit, Target};
pub use params::LoopParams;
pub use state::{LoopState, LoopView, Outcome, TimedPose};
