//! One file for each command of `trifacet`; `main.rs` only chooses.

pub(crate) mod watch;
