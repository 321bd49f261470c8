//! The consumer kits of `clients/`, each beside the Rust client: same bytes in, same bits out.
//!
//! The LinuxCNC component runs under the real HAL, by way of `linuxcnc.sh`.

mod decoding;
mod fixture;
mod linuxcnc;
mod receiving;
mod tables;
mod tools;
mod twincat;
