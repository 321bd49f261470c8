//! The command line of trifacet.

mod commands;

fn main() {}
