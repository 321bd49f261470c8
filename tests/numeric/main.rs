//! Numerical tests: the sensor model and its inverse, the accuracy of the poses, and the centering loop
//! in lockstep with the twin.
//!
//! Many of these tests print tables: `cargo test --test numeric NAME -- --nocapture`.

#![allow(clippy::unwrap_used)]

mod accuracy;
mod calibrated;
mod centering;
mod false_alarms;
mod misprints;
mod optics;
mod optics_reference;
mod own_head;
mod year;
