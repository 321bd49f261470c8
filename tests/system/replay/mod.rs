//! Replay, inspection, recovery and export of recordings through the binary.

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
