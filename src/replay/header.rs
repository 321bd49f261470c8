//! What a recording says at its beginning, before anything of it is replayed.

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
    /// What poses mean.
    pub context: Arc<CalibrationContext>,
    /// The source, if one was up.
    pub source: Option<Arc<Identity>>,
    /// The moment of the first frame, and its nanoseconds of UTC since 1970.
    pub first: (Mono, i64),
}

impl RecordingHeader {
    /// That of the recording that is the source, if one is.
    ///
    /// # Errors
    /// As [`RecordingHeader::of`].
    pub fn of_source(config: &Config) -> Result<Option<Self>, Failure> {
        let replayed = config.acquisition.source == SourceKind::Replay;
        replayed.then(|| Self::of(&config.replay.file)).transpose()
    }

    /// Reads as far as it must. Blocks.
    ///
    /// # Errors
    /// [`exit::CONFIG`]: it cannot be read, or there is nothing in it that could be replayed.
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
        Err(wrong(format!("no {lacks} is in {}, so nothing can be replayed", file.display())))
    }

    /// Samples per second, as they were recorded.
    pub fn rate_hz(&self) -> f64 {
        self.source.as_ref().map_or(self.context.config.acquisition.rate_hz, |source| source.rate_hz)
    }

    /// The configuration that holds while it is replayed: what poses mean stands in the recording, and nothing steers.
    pub fn holding(&self, config: &Config) -> Config {
        let Config { head, channels, estimation, frames, .. } = self.context.config.clone();
        let mut config = Config { head, channels, estimation, frames, ..config.clone() };
        config.acquisition.rate_hz = self.rate_hz();
        config.centering.mode = LoopMode::Off;
        config
    }

    /// For whoever gets the stream.
    pub fn told(&self, config: &ReplayConfig) -> Replayed {
        let ReplayConfig { file, speed, repeat } = config;
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Replayed { file: name, recorded: rfc3339(self.first.1), speed: *speed, repeat: *repeat }
    }
}
