//! The consumer kits of `clients/`, each beside the Rust client: same bytes in, same bits out.
//!
//! The LinuxCNC component has a test of its own, under the real HAL: `tests/kits/linuxcnc.sh`.

#![allow(clippy::unwrap_used)]

mod decoding;
mod fixture;
mod receiving;
mod tables;
mod tools;
mod twincat;
#[path = "../shared/venv.rs"]
mod venv;
