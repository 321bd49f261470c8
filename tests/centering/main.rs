//! The loop as a whole, in lockstep with the twin: how well it follows, how surely it finds the apex, and
//! that it never claims what is not so.
//!
//! `cargo test --test centering -- --nocapture` prints the tables.

#![allow(clippy::unwrap_used)]

mod faults;
mod finding;
mod following;
