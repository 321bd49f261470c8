//! Health and metrics of the binary, requested as by a browser or a scraper.

mod health;
mod metrics;
pub(crate) mod page;
mod server;
mod stall;
