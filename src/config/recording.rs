//! `[recording]`: what is written to files.

use std::ops::{RangeBounds as _, RangeInclusive};
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::check::{Checker, above_zero};

/// When is recorded. `trifacet ctl record start` does so at any time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RecordingMode {
    /// Only by command.
    Off,
    /// From the start on.
    Always,
    /// What led to a fault, and what came of it.
    OnFault,
}

impl RecordingMode {
    /// As in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Always => "always",
            Self::OnFault => "on-fault",
        }
    }
}

/// How files are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Compression {
    /// Not at all.
    None,
    /// Fast.
    Lz4,
    /// Smaller.
    Zstd,
}

/// Files that the budget must hold: one that is being finished, one that is being written, and one to keep.
const FILES: f64 = 3.0;
/// Sizes that a file may have, MB, and the largest budget, GB.
const ROTATE_MB: RangeInclusive<f64> = 1.0..=100_000.0;
const BUDGET_GB: f64 = 100_000.0;

/// `[recording]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecordingConfig {
    /// Where the files are.
    pub folder: PathBuf,
    /// When is recorded.
    pub mode: RecordingMode,
    /// How files are compressed.
    pub compression: Compression,
    /// Size at which the next file begins.
    pub rotate_mb: f64,
    /// Age at which the next file begins.
    pub rotate_min: f64,
    /// Room for all recordings in the folder: the oldest are deleted.
    pub budget_gb: f64,
    /// How long before a fault a recording begins.
    pub before_s: f64,
    /// How long after the beginning of a fault it ends.
    pub after_s: f64,
}

impl Default for RecordingConfig {
    fn default() -> Self {
        Self {
            folder: "/var/lib/trifacet/recordings".into(),
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
        // What is wrong by itself is said already.
        let sane = ROTATE_MB.contains(&rotate_mb) && above_zero(BUDGET_GB).contains(&budget_gb);
        at.demand(!sane || budget_gb >= least, "budget_gb", budget_gb, allowed);
    }
}
