//! `[log]`: level and format of the log.

use serde::{Deserialize, Serialize};
use tracing_subscriber::filter::Targets;

use super::check::Checker;

/// Format of the log lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogFormat {
    /// Plain text.
    Text,
    /// One JSON object per line.
    Json,
}

/// Settings of `[log]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// Level: error, warn, info, debug or trace, or a filter such as `trifacet::twin=debug`.
    pub level: String,
    /// Format of the lines.
    pub format: LogFormat,
}

impl Default for LogConfig {
    fn default() -> Self {
        Self { level: "info".into(), format: LogFormat::Text }
    }
}

const LEVELS: [&str; 6] = ["off", "error", "warn", "info", "debug", "trace"];

impl LogConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        // A misspelt level would be parsed as the name of a module, and nothing would be logged.
        let levels = self.level.split(',').all(|part| {
            let level = part.rsplit('=').next().unwrap_or_default().trim().to_lowercase();
            LEVELS.contains(&level.as_str())
        });
        let fine = levels && self.level.parse::<Targets>().is_ok();
        let allowed =
            "off, error, warn, info, debug or trace, or a list such as \"info,trifacet::twin=debug\"";
        at.demand(fine, "level", format!("{:?}", self.level), allowed);
    }
}
