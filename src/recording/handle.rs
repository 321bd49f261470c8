//! What the rest of the house sees of the recorder, and may ask of it.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::{Value, json};
use tokio::sync::{mpsc, oneshot};

use crate::config::RecordingMode;
use crate::exit::Failure;

/// What may be asked of the recorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecorderCommand {
    /// To record from now on, with what is in the ring.
    Start,
    /// To end the recording.
    Stop,
    /// To do as if there were a fault.
    Trigger,
}

impl RecorderCommand {
    /// Every command.
    pub const ALL: [RecorderCommand; 3] =
        [RecorderCommand::Start, RecorderCommand::Stop, RecorderCommand::Trigger];

    /// The command as a word.
    pub fn name(self) -> &'static str {
        match self {
            RecorderCommand::Start => "start",
            RecorderCommand::Stop => "stop",
            RecorderCommand::Trigger => "trigger",
        }
    }
}

/// A command with the way back: done, or why not.
pub type Asked = (RecorderCommand, oneshot::Sender<Result<(), Failure>>);

/// What holds at present.
#[derive(Debug)]
pub struct State {
    /// By the configuration.
    pub mode: RecordingMode,
    /// Data are lost at present: what the frames say.
    pub fault: Arc<AtomicBool>,
    /// A file is being written.
    pub recording: AtomicBool,
    /// Room on the file system of the recordings, bytes; `u64::MAX` while it is not known.
    pub free: AtomicU64,
    /// What the ring takes, bytes.
    pub ring: AtomicU64,
    words: Mutex<Words>,
}

#[derive(Debug, Default)]
struct Words {
    file: Option<PathBuf>,
    fault: Option<String>,
}

impl State {
    /// Of a recorder that does nothing yet.
    pub fn new(mode: RecordingMode) -> Self {
        Self {
            mode,
            fault: Arc::default(),
            recording: AtomicBool::new(false),
            free: AtomicU64::new(u64::MAX),
            ring: AtomicU64::new(0),
            words: Mutex::default(),
        }
    }

    /// Says which file is being written.
    pub fn file(&self, file: Option<PathBuf>) {
        self.recording.store(file.is_some(), Ordering::Relaxed);
        self.words().file = file;
    }

    /// Says why data are lost.
    pub fn fault(&self, why: Option<String>) {
        self.fault.store(why.is_some(), Ordering::Relaxed);
        self.words().fault = why;
    }

    /// Room on the file system of the recordings, bytes, if it is known.
    pub fn free(&self) -> Option<u64> {
        Some(self.free.load(Ordering::Relaxed)).filter(|free| *free < u64::MAX)
    }

    /// For people.
    pub fn tell(&self) -> Value {
        let words = self.words();
        json!({
            "mode": self.mode.name(),
            "recording": self.recording.load(Ordering::Relaxed),
            "file": words.file,
            "fault": words.fault,
            "ring_bytes": self.ring.load(Ordering::Relaxed),
            "free_bytes": self.free(),
        })
    }

    fn words(&self) -> MutexGuard<'_, Words> {
        self.words.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The way to the recorder.
#[derive(Clone, Debug)]
pub struct Handle {
    /// What holds at present.
    pub state: Arc<State>,
    /// Where wishes go.
    pub wishes: mpsc::Sender<Asked>,
}
