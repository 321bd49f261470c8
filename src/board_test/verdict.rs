//! Results of the rules.

use std::fmt;

use serde::Serialize;

use super::line::TestError;

/// Why a rule does not pass.
#[derive(Debug)]
pub enum Broken {
    /// The board breaks the rule.
    Fail {
        /// What the board did.
        seen: String,
        /// What the document requires.
        expected: String,
    },
    /// This computer was too busy to send or to read in time.
    Busy,
    /// The rule does not apply, or cannot be checked.
    Skip(String),
    /// The port fails.
    Port(TestError),
}

impl From<TestError> for Broken {
    fn from(error: TestError) -> Self {
        Self::Port(error)
    }
}

/// A broken rule.
///
/// # Errors
/// Always: this is the error.
pub fn fail<T>(seen: impl Into<String>, expected: impl Into<String>) -> Result<T, Broken> {
    Err(Broken::Fail { seen: seen.into(), expected: expected.into() })
}

/// The verdict on a rule.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "verdict", content = "details")]
pub enum Verdict {
    /// The board keeps the rule; with what was seen.
    #[serde(rename = "PASS")]
    Pass(String),
    /// The board breaks the rule.
    #[serde(rename = "FAIL")]
    Fail {
        /// What the board did.
        seen: String,
        /// What the document requires.
        expected: String,
    },
    /// The rule was not checked, for this reason.
    #[serde(rename = "SKIP")]
    Skip(String),
}

/// The verdict on a rule that was checked.
///
/// # Errors
/// The port failed.
pub fn of(checked: Result<String, Broken>) -> Result<Verdict, TestError> {
    Ok(match checked {
        Ok(seen) => Verdict::Pass(seen),
        Err(Broken::Fail { seen, expected }) => Verdict::Fail { seen, expected },
        Err(Broken::Skip(why)) => Verdict::Skip(why),
        Err(Broken::Busy) => Verdict::Skip("this computer is too busy to send its commands in time".into()),
        Err(Broken::Port(error)) => return Err(error),
    })
}

/// A rule with its verdict.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Outcome {
    /// Name of the rule.
    pub rule: &'static str,
    /// Section of the document that contains it.
    pub section: &'static str,
    /// The verdict.
    #[serde(flatten)]
    pub verdict: Verdict,
}

impl Outcome {
    /// Whether the board breaks the rule.
    pub fn failed(&self) -> bool {
        matches!(self.verdict, Verdict::Fail { .. })
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rule, section, verdict } = self;
        match verdict {
            Verdict::Pass(seen) => write!(f, "PASS  {rule:<20} {seen}"),
            Verdict::Skip(why) => write!(f, "SKIP  {rule:<20} {why}"),
            Verdict::Fail { seen, expected } => {
                write!(f, "FAIL  {rule:<20} seen: {seen}\n{:27}expected: {expected} (\"{section}\")", "")
            }
        }
    }
}
