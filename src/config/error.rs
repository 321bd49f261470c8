//! What is wrong with a configuration, said so that it can be mended.

use std::fmt;
use std::path::PathBuf;

use super::locate::Place;

/// Why there is no configuration.
#[derive(Debug)]
pub enum ConfigError {
    /// The file cannot be read.
    Unreadable {
        /// Which file.
        file: PathBuf,
        /// What the system says.
        reason: std::io::Error,
    },
    /// The file was read and is wrong.
    Wrong {
        /// Which file; none if there was none (then the defaults are wrong: a defect).
        file: Option<PathBuf>,
        /// Everything that is wrong with it; never empty.
        problems: Vec<Problem>,
    },
}

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Where in the file; none if the file does not say anything about it.
    pub place: Option<Place>,
    /// The key with its full path, what was found, and what is allowed.
    pub message: String,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (file, problems) = match self {
            Self::Unreadable { file, reason } => {
                return write!(f, "cannot read the configuration {}: {reason}", file.display());
            }
            Self::Wrong { file, problems } => (file, problems),
        };
        let file = file.as_ref().map_or("(defaults)".into(), |file| file.display().to_string());
        for (i, problem) in problems.iter().enumerate() {
            let start = if i == 0 { "" } else { "\n" };
            match problem.place {
                Some(Place { line, column }) => write!(f, "{start}{file}:{line}:{column}: ")?,
                None => write!(f, "{start}{file}: ")?,
            }
            f.write_str(&problem.message)?;
        }
        Ok(())
    }
}

impl std::error::Error for ConfigError {}
