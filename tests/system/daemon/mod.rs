//! The daemon through its front door: the real binary, its sockets, a pseudo-terminal, signals.
//!
//! Whatever a test looks for, every frame that it receives is held to the rules of `testkit::honest`.

mod channels;
mod clients;
mod doubts;
mod ending;
mod faults;
mod gcs;
mod loop_closed;
mod running;
mod service;
