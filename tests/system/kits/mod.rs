//! The consumer kits of `clients/`, each compared with the Rust client: same bytes in, same bits out.
//!
//! The LinuxCNC component runs under the real HAL, through `linuxcnc.sh`.

mod decoding;
mod fixture;
mod linuxcnc;
mod receiving;
mod tables;
pub(crate) mod tools;
mod twincat;
mod usability;
