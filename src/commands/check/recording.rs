//! Explains the settings for recordings.

use trifacet::config::{Config, RecordingConfig, RecordingMode, SourceKind};
use trifacet::recording::folder::Folder;

use super::Lines;

pub(super) fn recording(config: &Config, lines: &mut Lines) {
    if config.acquisition.source == SourceKind::Replay {
        return lines.say("recording", "off: a recording is replayed");
    }
    let RecordingConfig { mode, rotate_mb, rotate_min, budget_gb, before_s, after_s, .. } = config.recording;
    let when = match mode {
        RecordingMode::Off => "off until `trifacet ctl record start`".to_owned(),
        RecordingMode::Always => "from the start".to_owned(),
        RecordingMode::OnFault => format!("from {before_s} s before each fault to {after_s} s after it"),
    };
    lines.say("recording", format!("{when}, in {}", config.recording.folder.display()));
    lines.say(
        "",
        format!(
            "a new file at {rotate_mb} MB or {rotate_min} min; all files at most {budget_gb} GB, the oldest are deleted"
        ),
    );
}

/// A note on a folder that cannot be used. It is omitted if no recording is configured.
pub(super) fn note(config: &Config, lines: &mut Lines) {
    let RecordingConfig { mode, folder, .. } = &config.recording;
    if *mode == RecordingMode::Off {
        return;
    }
    if let Err(why) = Folder(folder.clone()).usable() {
        let folder = folder.display();
        lines.say(
            "note",
            format!("recording.folder, {folder}, cannot be used by the user of this command: {why}"),
        );
    }
}
