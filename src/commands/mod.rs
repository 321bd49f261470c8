//! One file for each command of `trifacet`; `main.rs` only chooses.

mod watch;

pub(crate) use watch::{WatchArgs, watch};
