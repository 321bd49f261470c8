//! Health and metrics through the front door: the real binary, asked as a browser or a scraper asks.

#![allow(clippy::unwrap_used)]

mod health;
mod metrics;
mod page;
mod server;
mod stall;

#[path = "../daemon/fixture/mod.rs"]
#[allow(dead_code, unused_imports, reason = "shared with the daemon's tests, which need more of it")]
mod fixture;
#[path = "../shared/venv.rs"]
mod venv;
