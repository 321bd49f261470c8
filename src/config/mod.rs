//! The configuration file: TOML to checked settings.
//!
//! Every key has a default and carries its unit in its name. Unknown keys and values out of range are
//! refused with file, line, key and what is allowed.

pub mod sections;

pub use sections::*;
