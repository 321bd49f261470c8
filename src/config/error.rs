//! Errors of a configuration, with the place and what is allowed.

use std::fmt;
use std::path::PathBuf;

use super::check::Finding;
use super::locate::Place;

/// Why a configuration could not be loaded.
#[derive(Debug)]
pub enum ConfigError {
    /// The file cannot be read.
    Unreadable {
        /// Path of the file.
        file: PathBuf,
        /// Error of the operating system.
        reason: std::io::Error,
    },
    /// The file was read and is not valid.
    Wrong {
        /// Path of the file. `None` if the defaults themselves are wrong, which is a defect of the program.
        file: Option<PathBuf>,
        /// All problems. Never empty.
        problems: Vec<Problem>,
    },
}

/// One problem of a configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Place in the file. `None` if the file does not contain the key.
    pub place: Option<Place>,
    /// Full path of the key, the value found, and what is allowed.
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

/// Values that are not allowed, in a configuration that was not parsed from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct InvalidValues(pub(super) Vec<Finding>);

impl fmt::Display for InvalidValues {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, Finding { keys, found, allowed }) in self.0.iter().enumerate() {
            let start = if i == 0 { "" } else { "; " };
            write!(f, "{start}{} = {found}: allowed is {allowed}", keys[0])?;
        }
        Ok(())
    }
}

impl std::error::Error for InvalidValues {}
