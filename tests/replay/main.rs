//! Recordings computed again, looked at, saved and exported, through the binary.

#![allow(clippy::unwrap_used)]

mod daemon;
mod daemon_hole;
mod damage;
mod export;
mod files;
mod fixture;
mod holes;
mod identity;
#[cfg(feature = "parquet")]
mod pandas;
#[cfg(feature = "parquet")]
#[path = "../shared/venv.rs"]
mod venv;
