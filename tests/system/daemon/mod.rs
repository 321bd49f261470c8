//! The daemon through its public interfaces: the binary, its sockets, a pseudo-terminal, signals.
//!
//! Every frame that a test receives is also checked against the rules of `testkit::honest`.

mod bursts;
mod calibration;
mod calibration_drift;
mod channels;
mod clients;
mod commands;
mod doubts;
mod ending;
mod faults;
mod gcs;
mod lock_causes;
mod loop_closed;
mod running;
mod service;
mod standing_doubts;
mod terminal;
