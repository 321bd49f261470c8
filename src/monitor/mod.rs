//! What people and machines see of a running daemon. Nothing here can hold up the fast side.
//!
//! - [`view`]: frames, configuration and counters, for whoever looks.
//! - [`health`], [`tally`], [`trend`]: what becomes of every frame. Pure.
//! - [`metrics`]: all that as Prometheus reads it.
//! - [`page`]: the live page.
//! - [`http`]: the server. [`host_filter`]: which requests are meant for it.

pub mod health;
pub mod host_filter;
pub mod http;
pub mod metrics;
pub mod page;
pub mod tally;
pub mod trend;
pub mod view;
