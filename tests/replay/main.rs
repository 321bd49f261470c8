//! Recordings computed again, looked at, saved and exported, through the binary.

#![allow(clippy::unwrap_used)]

mod daemon;
mod damage;
mod export;
mod fixture;
mod hole;
mod identity;
#[cfg(feature = "parquet")]
mod pandas;
#[cfg(feature = "parquet")]
#[path = "../shared/venv.rs"]
mod venv;
