//! The beginning of a recording, read before it is replayed.

use std::path::Path;
use std::sync::Arc;

use trifacet_core::centering::LoopMode;
use trifacet_core::signals::Identity;
use trifacet_core::time::Mono;
use trifacet_wire::stream::Replayed;

use crate::config::{CalibrationContext, Config, ReplayConfig, SourceKind};
use crate::exit::{self, Failure};
use crate::publishing::columns::rfc3339;
use crate::recording::reader::Read;
use crate::recording::{Entry, Reader};

/// The first configuration and the first frame of a recording.
#[derive(Clone, Debug)]
pub struct RecordingHeader {
    /// First configuration and tables.
    pub context: Arc<CalibrationContext>,
    /// The source, if one was up.
    pub source: Option<Arc<Identity>>,
    /// Time of the first frame: monotonic, and UTC in nanoseconds since 1970.
    pub first: (Mono, i64),
}

impl RecordingHeader {
    /// The header of the recording that is the source of this configuration; `None` for other sources.
    ///
    /// # Errors
    /// As [`RecordingHeader::of`].
    pub fn of_source(config: &Config) -> Result<Option<Self>, Failure> {
        let replayed = config.acquisition.source == SourceKind::Replay;
        replayed.then(|| Self::of(&config.replay.file)).transpose()
    }

    /// Reads a file up to its first configuration and frame. Blocks.
    ///
    /// # Errors
    /// [`exit::CONFIG`]: the file cannot be read, or contains no configuration or no frame.
    pub fn of(file: &Path) -> Result<Self, Failure> {
        let wrong = |why: String| Failure::new(exit::CONFIG, format!("replay.file: {why}"));
        let mut reader = Reader::open(file, Reader::REPLAY).map_err(|e| wrong(e.to_string()))?;
        let (mut configured, mut first) = (None, None);
        while let Some(read) = reader.read().map_err(|e| wrong(e.to_string()))? {
            match read {
                Read::Entry(Entry::Keyframe(keyframe)) => {
                    configured.get_or_insert((keyframe.context, keyframe.source));
                }
                Read::Foreign { context, source, .. } => {
                    configured.get_or_insert((context, source));
                }
                Read::Entry(Entry::Frame { frame, time, .. }) => {
                    first.get_or_insert((time, frame.time_ns));
                }
                _ => {}
            }
            if let (Some((context, source)), Some(first)) = (&configured, first) {
                return Ok(Self { context: Arc::clone(context), source: source.clone(), first });
            }
        }
        let lacks = if configured.is_none() { "configuration" } else { "frame" };
        Err(wrong(format!("{} contains no {lacks}, so it cannot be replayed", file.display())))
    }

    /// Sample rate of the recording in Hz.
    pub fn rate_hz(&self) -> f64 {
        self.source.as_ref().map_or(self.context.config.acquisition.rate_hz, |source| source.rate_hz)
    }

    /// The configuration during a replay: everything that poses depend on is from the recording, and there is
    /// no steering.
    pub fn holding(&self, config: &Config) -> Config {
        let Config { head, channels, calibration, estimation, frames, .. } = self.context.config.clone();
        let mut config = Config { head, channels, calibration, estimation, frames, ..config.clone() };
        config.acquisition.rate_hz = self.rate_hz();
        config.centering.mode = LoopMode::Off;
        config
    }

    /// The description of the replay for receivers of the stream.
    pub fn replayed(&self, config: &ReplayConfig) -> Replayed {
        let ReplayConfig { file, speed, repeat } = config;
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Replayed { file: name, recorded: rfc3339(self.first.1), speed: *speed, repeat: *repeat }
    }
}
