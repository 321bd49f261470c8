//! Task 2: keeps the beam on the apex.

pub mod lock;

pub use lock::LockState;
