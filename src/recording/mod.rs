//! The record of what went in and what came out, so that a measurement can be replayed.
//!
//! - [`entry`]: what is recorded, as the fast side hands it over without ever waiting.
//! - [`estimation_recorder`]: what estimation says for the record, with a keyframe every second.
//! - [`schema`], [`message`]: topics and messages, as tools for ROS 2 know them. [`codec`]: entries to messages and back.
//! - [`reader`]: a file to entries, past every damage.
//! - [`writer`]: messages to a file. [`ring`]: the last seconds in memory. [`folder`], `output`, `disk`: where files are.
//! - [`recorder`]: the thread that does it. [`trigger`]: when. [`handle`]: what others see of it.

pub mod codec;
mod disk;
pub mod entry;
pub mod estimation_recorder;
pub mod folder;
pub mod handle;
pub mod message;
mod output;
pub mod reader;
pub mod recorder;
pub mod ring;
pub mod schema;
pub mod trigger;
pub mod writer;

pub use entry::{Entry, Keyframe, RecordSender};
pub use estimation_recorder::EstimationRecorder;
pub use handle::{Handle, RecorderCommand};
pub use reader::Reader;
pub use schema::Topic;
