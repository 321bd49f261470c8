//! Datagrams. Every receiver has a socket of its own, so that one that does not answer delays no other.
//!
//! - [`receiver`]: a receiver as both sides know it, with its counts.
//! - [`sender`]: the fast side. It sends each frame to the receivers that are due for it.
//! - [`supervisor`]: the task on the main thread that resolves names, opens sockets, and reports receivers that
//!   cannot be reached. It uses [`resolve`], [`socket`], [`path`] and, to judge a receiver, [`health`].

pub mod cause;
pub mod health;
pub mod path;
pub mod receiver;
pub mod resolve;
pub mod sender;
pub mod socket;
pub mod supervisor;

pub use receiver::{Kind, Receiver, Way};
pub use sender::Sender;
pub use supervisor::{ReceiverState, Supervisor};
