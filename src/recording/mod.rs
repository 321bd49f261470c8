//! Records the inputs and outputs of the estimation, so that a measurement can be replayed.
//!
//! - [`entry`]: the recorded events, and the channel over which the fast side passes them without waiting.
//! - [`estimation_recorder`]: records the inputs of the estimation, with a keyframe every second.
//! - [`schema`], [`message`]: topics and messages, with ROS 2 definitions.
//! - [`codec`]: entries to messages and back.
//! - [`reader`]: a file to entries, skipping damaged parts.
//! - [`writer`]: messages to a file. [`ring`]: the last seconds in memory.
//! - [`folder`], `output`, `disk`: the files. `budget`: deletes old ones.
//! - [`recorder`]: the thread that writes. [`trigger`]: detects faults.
//! - [`handle`]: the interface of the recorder.

mod budget;
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
