//! One file for each command of `trifacet`; `main.rs` only chooses.

pub mod simulate;
