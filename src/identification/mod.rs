//! Identifies the loop on the live system: the response of the beam to steps of each axis.
//!
//! - [`response`]: gain, delay and lag from recorded steps.
//! - [`observation`]: positions of beam and stage in a sample.
//! - [`plan`]: chooses safe steps, and refuses unsafe ones.
//! - `probe`: checks whether the beam responds within a dwell time.
//! - [`task`]: receives samples, makes the steps, and returns the stage. It takes the place of centering.
//! - `gaps`: times without samples, and how often a step is repeated.
//! - [`record`]: the steps and observations of a measurement.
//! - [`origin`]: what a large origin can mean.
//! - [`findings`]: the resulting keys of the configuration, and whether they can be trusted.
//!
//! Everything but the task is pure.

pub mod findings;
mod gaps;
pub mod observation;
pub mod origin;
pub mod plan;
mod probe;
pub mod record;
pub mod response;
pub mod task;
