//! Health and metrics through the front door: the real binary, asked as a browser or a scraper asks.

mod health;
mod metrics;
mod page;
mod server;
mod stall;
