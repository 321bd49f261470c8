//! `[log]`: what is logged, and in which form.

use serde::{Deserialize, Serialize};
use tracing_subscriber::filter::EnvFilter;

use super::check::Checker;

/// Form of the log lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// `[log]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// What is logged: error, warn, info, debug, trace, or a filter such as `trifacet::twin=debug`.
    pub level: String,
    /// In which form.
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
        // A misspelt level parses as the name of a module, and then nothing at all is logged.
        let levels = self.level.split(',').all(|part| {
            let level = part.rsplit('=').next().unwrap_or_default().trim().to_lowercase();
            LEVELS.contains(&level.as_str())
        });
        let fine = levels && EnvFilter::builder().parse(&self.level).is_ok();
        let allowed =
            "off, error, warn, info, debug or trace, or a list such as \"info,trifacet::twin=debug\"";
        at.demand(fine, "level", format!("{:?}", self.level), allowed);
    }
}
