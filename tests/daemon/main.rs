//! The daemon through its front door: the real binary, its sockets, a pseudo-terminal, signals.
//!
//! Whatever a test looks for, every frame that it receives is held to the rules of `fixture::honest`.

#![allow(clippy::unwrap_used)]

mod channels;
mod clients;
mod doubts;
mod ending;
mod faults;
mod fixture;
mod gcs;
mod loop_closed;
mod running;
mod service;
