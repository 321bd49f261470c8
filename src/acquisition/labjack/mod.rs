//! A LabJack T7 as a source of scans, with its two outputs for the stage.
//!
//! The device has two TCP ports: Modbus TCP for its registers, and the packets of its stream. Everything but
//! [`source`] is pure: bytes and times in, bytes and events out.
//!
//! - [`registers`], [`modbus`]: the registers, and the frames that read and write them.
//! - [`stream`], [`scans`]: packets of the stream, and the scans in them. Every status is accounted for.
//! - [`calibration`], [`clock`], [`outputs`]: from codes to volts, from the timer of the device to the time of the
//!   host, from output codes to volts.
//! - [`setup`], [`session`]: from a connection to a running stream, and the state machine of the whole.
//!
//! Two lines guard the outputs. The session parks them if no command arrives within its lease. The watchdog of the
//! device parks them if the session itself has died; it counts in whole seconds.

pub mod calibration;
pub mod clock;
mod faults;
pub mod modbus;
pub mod outputs;
pub mod registers;
pub mod scans;
pub mod session;
pub mod settings;
pub mod setup;
pub mod source;
pub mod stream;

pub use session::Session;
pub use settings::Settings;
pub use source::LabjackSource;
