//! Acquisition: raw codes to [`Sample`](trifacet_core::signals::Sample)s.
//!
//! A [`Source`] (the twin, a board or a LabJack T7) delivers [`Scan`](trifacet_core::signals::Scan)s of raw
//! converter codes. The channel map turns each scan into a sample in metres and watts. Steering commands go
//! to the source.
//!
//! - [`source`]: the trait of a source, and its events. [`task`]: the acquisition task.
//! - [`board_source`]: a board at a serial port or on a network. [`board`]: the host side of its protocol.
//! - [`labjack`]: a LabJack T7.
//! - [`in_flight`]: the steering commands without an acknowledgement.
//! - [`timebase`]: from ticks of the board to the time of the host.

pub mod board;
pub mod board_source;
pub mod in_flight;
pub mod labjack;
pub mod source;
pub mod task;
pub mod timebase;

pub use board_source::BoardSource;
pub use labjack::LabjackSource;
pub use source::{Source, SourceError, SourceEvent};
