//! `[replay]`: a recording as a source.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::check::Checker;

/// `[replay]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReplayConfig {
    /// The recording, relative to the configuration file.
    pub file: PathBuf,
    /// So many times as fast as it was recorded.
    pub speed: f64,
    /// Begins again at the end.
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
