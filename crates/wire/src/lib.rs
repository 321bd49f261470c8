//! Byte formats of everything that trifacet sends or receives, for both ends of the connection.
//!
//! - [`PoseFrame`]: one pose with its uncertainty and status, 192 bytes (`docs/stream.md`). [`layout`] is its
//!   byte table, [`byte_order`] the same frame in network byte order, [`held`] keeps the last valid pose.
//! - [`Status`]: the status bits of a frame. [`LockState`]: the state of the centering loop.
//! - [`message`]: header and CRC of every message on a TCP stream.
//! - [`channel`], [`actuator`]: channels and outputs of a converter board.
//! - `board` (feature `board`): the protocol of the acquisition board (`docs/board-protocol.md`).
//! - `stream` (feature `stream`): messages in JSON, and the requests of clients.
//!
//! `no_std`; the feature `board` needs an allocator, `stream` the standard library.
//!
//! ```
//! use trifacet_wire::{PoseFrame, Status};
//!
//! let datagram = PoseFrame::example().encode(); // 192 bytes, as they arrive by UDP
//! let frame = PoseFrame::decode(&datagram)?;
//! assert!(frame.status.has(Status::POSE_VALID));
//! let [tx, ty, tz, roll, pitch, yaw] = frame.pose; // metres and radians; NaN without POSE_VALID
//! # let _ = (tx, ty, tz, roll, pitch, yaw);
//! # Ok::<(), trifacet_wire::FrameError>(())
//! ```

#![cfg_attr(not(any(test, feature = "stream")), no_std)]

#[cfg(feature = "board")]
extern crate alloc;

pub mod actuator;
#[cfg(feature = "board")]
pub mod board;
pub mod byte_order;
pub mod channel;
pub mod frame;
pub mod held;
pub mod layout;
pub mod lock;
pub mod message;
pub mod status;
#[cfg(feature = "stream")]
pub mod stream;

pub use frame::{FrameError, PoseFrame};
pub use lock::LockState;
pub use status::Status;
