//! `[replay]`: a recording as the source of samples.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::check::Checker;

/// Settings of `[replay]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReplayConfig {
    /// Path of the recording, relative to the configuration file.
    pub file: PathBuf,
    /// Speed of the replay relative to that of the recording.
    pub speed: f64,
    /// Whether the replay starts again at the end of the recording.
    pub repeat: bool,
}

impl Default for ReplayConfig {
    fn default() -> Self {
        Self { file: PathBuf::new(), speed: 1.0, repeat: false }
    }
}

impl ReplayConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("speed", self.speed, 0.001..=1000.0);
    }
}
