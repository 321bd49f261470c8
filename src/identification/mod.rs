//! Measures the loop on the live system: what a step of each axis does to the beam, and when.
//!
//! - [`response`]: from recorded steps to gain, delay and lag.
//! - [`observation`]: what a sample says of beam and stage.
//! - [`plan`]: which steps are safe, and which are refused.
//! - `probe`: whether the beam answers within a dwell.
//! - [`task`]: takes samples, makes the steps, and brings the stage back. Stands where centering does.
//! - [`findings`]: what follows for the configuration, and whether it can be trusted.
//!
//! All but the task is pure.

pub mod findings;
pub mod observation;
pub mod plan;
mod probe;
pub mod response;
pub mod task;
