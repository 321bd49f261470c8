//! Monitoring of a running daemon for operators and programs. Nothing here can delay the fast side.
//!
//! - [`view`]: frames, configuration and counters for the pages.
//! - [`health`], [`recent`], [`tally`], [`trend`]: evaluation of every frame. Pure.
//! - [`metrics`]: the metrics page for Prometheus. [`exposition`]: its two formats.
//! - [`page`]: the live page.
//! - [`http`]: the server. [`host_filter`]: refuses requests that are meant for other hosts.

pub mod exposition;
pub mod health;
pub mod host_filter;
pub mod http;
pub mod metrics;
pub mod page;
pub mod recent;
pub mod tally;
pub mod trend;
pub mod view;
