//! The interface of the recorder: its commands and its state.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::{Value, json};
use tokio::sync::{mpsc, oneshot};

use crate::config::RecordingMode;
use crate::exit::Failure;

/// A command to the recorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecorderCommand {
    /// Record from now on, including the contents of the ring.
    Start,
    /// End the recording.
    Stop,
    /// Act as if a fault had occurred.
    Trigger,
}

impl RecorderCommand {
    /// Every command.
    pub const ALL: [RecorderCommand; 3] =
        [RecorderCommand::Start, RecorderCommand::Stop, RecorderCommand::Trigger];

    /// Name of the command.
    pub fn name(self) -> &'static str {
        match self {
            RecorderCommand::Start => "start",
            RecorderCommand::Stop => "stop",
            RecorderCommand::Trigger => "trigger",
        }
    }
}

/// A command with the channel for its result.
pub type Asked = (RecorderCommand, oneshot::Sender<Result<(), Failure>>);

/// State of the recorder.
#[derive(Debug)]
pub struct State {
    /// Mode from the configuration.
    pub mode: RecordingMode,
    /// Data are being lost. Frames carry this as `RECORDING_FAULT`.
    pub fault: Arc<AtomicBool>,
    /// A file is being written.
    pub recording: AtomicBool,
    /// Free space on the file system of the recordings in bytes; `u64::MAX` if unknown.
    pub free: AtomicU64,
    /// Memory used by the ring, bytes.
    pub ring: AtomicU64,
    words: Mutex<Words>,
}

#[derive(Debug, Default)]
struct Words {
    file: Option<PathBuf>,
    /// The last recording that is complete.
    last: Option<PathBuf>,
    fault: Option<String>,
}

impl State {
    /// The initial state.
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

    /// Sets the file that is being written.
    pub fn file(&self, file: Option<PathBuf>) {
        self.recording.store(file.is_some(), Ordering::Relaxed);
        self.words().file = file;
    }

    /// Name of the file that is being written, without its folder.
    pub fn file_name(&self) -> Option<String> {
        Some(self.words().file.as_ref()?.file_name()?.to_string_lossy().into_owned())
    }

    /// Sets the last recording that is complete.
    pub fn finished(&self, file: PathBuf) {
        self.words().last = Some(file);
    }

    /// Sets the reason for which data are being lost.
    pub fn fault(&self, why: Option<String>) {
        self.fault.store(why.is_some(), Ordering::Relaxed);
        self.words().fault = why;
    }

    /// Free space on the file system of the recordings in bytes, if known.
    pub fn free(&self) -> Option<u64> {
        Some(self.free.load(Ordering::Relaxed)).filter(|free| *free < u64::MAX)
    }

    /// The state in JSON.
    pub fn tell(&self) -> Value {
        let words = self.words();
        json!({
            "mode": self.mode.name(),
            "recording": self.recording.load(Ordering::Relaxed),
            "file": words.file,
            "last": words.last,
            "fault": words.fault,
            "ring_bytes": self.ring.load(Ordering::Relaxed),
            "free_bytes": self.free(),
        })
    }

    fn words(&self) -> MutexGuard<'_, Words> {
        self.words.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Access to the recorder.
#[derive(Clone, Debug)]
pub struct Handle {
    /// State of the recorder.
    pub state: Arc<State>,
    /// Sends commands to the recorder.
    pub requests: mpsc::Sender<Asked>,
}
