//! `[recording]`: files with all measured data.

use std::ops::{RangeBounds as _, RangeInclusive};
use std::path::PathBuf;

use serde::{Deserialize, Deserializer, Serialize};

use super::check::{Checker, above_zero};
use super::places::{self, AUTO};

/// When the daemon records. `trifacet ctl record start` starts a recording in any mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RecordingMode {
    /// Only on command.
    Off,
    /// From the start.
    Always,
    /// The time around each fault.
    OnFault,
}

impl RecordingMode {
    /// The name, as in the configuration file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Always => "always",
            Self::OnFault => "on-fault",
        }
    }
}

/// Compression of the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Compression {
    /// No compression.
    None,
    /// LZ4: faster.
    Lz4,
    /// Zstandard: smaller files.
    Zstd,
}

/// Number of files that the budget must hold: one being finished, one being written, and one to keep.
const FILES: f64 = 3.0;
/// Allowed sizes of a file, MB, and largest budget, GB.
const ROTATE_MB: RangeInclusive<f64> = 1.0..=100_000.0;
const BUDGET_GB: f64 = 100_000.0;

/// Settings of `[recording]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecordingConfig {
    /// Folder for the files; `"auto"` in the file is that of [`places::recordings`].
    #[serde(deserialize_with = "folder_or_auto")]
    pub folder: PathBuf,
    /// When the daemon records.
    pub mode: RecordingMode,
    /// Compression of the files.
    pub compression: Compression,
    /// Size at which the next file begins, MB.
    pub rotate_mb: f64,
    /// Age at which the next file begins, minutes.
    pub rotate_min: f64,
    /// Space for all recordings in the folder, GB. The oldest are deleted.
    pub budget_gb: f64,
    /// Time before a fault at which its recording begins, seconds.
    pub before_s: f64,
    /// Time after the beginning of the last fault at which its recording ends, seconds.
    pub after_s: f64,
}

impl Default for RecordingConfig {
    fn default() -> Self {
        Self {
            folder: places::recordings(),
            mode: RecordingMode::Off,
            compression: Compression::Zstd,
            rotate_mb: 1000.0,
            rotate_min: 60.0,
            budget_gb: 20.0,
            before_s: 30.0,
            after_s: 10.0,
        }
    }
}

fn folder_or_auto<'de, D: Deserializer<'de>>(from: D) -> Result<PathBuf, D::Error> {
    let folder = PathBuf::deserialize(from)?;
    Ok(if folder.as_os_str() == AUTO { places::recordings() } else { folder })
}

impl RecordingConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        let folder = self.folder.display();
        let fine = !self.folder.as_os_str().is_empty();
        at.demand(fine, "folder", format!("{folder:?}"), "the path of a folder");
        at.number("rotate_mb", self.rotate_mb, ROTATE_MB);
        at.number("rotate_min", self.rotate_min, 0.05..=1440.0);
        at.number("budget_gb", self.budget_gb, above_zero(BUDGET_GB));
        at.number("before_s", self.before_s, 0.0..=300.0);
        at.number("after_s", self.after_s, 0.5..=3600.0);
        let (rotate_mb, budget_gb) = (self.rotate_mb, self.budget_gb);
        let least = FILES * rotate_mb / 1000.0;
        let allowed = format!("at least {least}: {FILES} files of recording.rotate_mb = {rotate_mb}");
        // A value that is out of its own range is reported elsewhere.
        let sane = ROTATE_MB.contains(&rotate_mb) && above_zero(BUDGET_GB).contains(&budget_gb);
        at.demand(!sane || budget_gb >= least, "budget_gb", budget_gb, allowed);
    }
}
