//! Standing doubts: reasons to doubt the poses that are conditions, not properties of single samples.
//!
//! A doubt is logged at its begin and at its end. While it stands, `ctl status`, `/readyz`, `/metrics`, the live
//! page and `trifacet doctor` show it.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use trifacet_core::telemetry::{DriftGauge, ResidualGauge};
use trifacet_core::time::Mono;

use crate::clock::utc::read_clocks;
use crate::grade::{Grade, Limitation};
use crate::publishing::columns::rfc3339;

/// What is doubted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Subject {
    /// The agreement of readback and pose (`INCONSISTENT`).
    Residual,
    /// The total power, which differs from its reference.
    Power,
    /// What the PSDs read without the laser.
    AmbientLight,
    /// The configured delay of the loop, which is shorter than the measured one.
    LoopDelay,
    /// Poses that depend on where the beam meets the mirror, by the last self-check.
    SelfCheck,
    /// The steering residual, which differs from that of the calibration.
    CalibrationDrift,
    /// What the PSDs read without the laser, by which the power gains differ from those of the calibration.
    DarkDrift,
}

impl Subject {
    /// All subjects.
    pub const ALL: [Subject; 7] = [
        Subject::Residual,
        Subject::Power,
        Subject::AmbientLight,
        Subject::LoopDelay,
        Subject::SelfCheck,
        Subject::CalibrationDrift,
        Subject::DarkDrift,
    ];

    /// Name of the subject, as on all outputs.
    pub fn name(self) -> &'static str {
        match self {
            Subject::Residual => "residual",
            Subject::Power => "power",
            Subject::AmbientLight => "ambient_light",
            Subject::LoopDelay => "loop_delay",
            Subject::SelfCheck => "self_check",
            Subject::CalibrationDrift => "calibration_drift",
            Subject::DarkDrift => "dark_drift",
        }
    }

    /// The line of the log at the end of the doubt.
    fn end(self) -> &'static str {
        match self {
            Subject::Residual => "steering and pose agree again",
            Subject::Power => "the total power is no longer doubted",
            Subject::AmbientLight => "the readings without light are no longer doubted",
            Subject::LoopDelay => "commands are applied within the configured loop delay again",
            Subject::SelfCheck => "the pose does not depend on the beam position any more",
            Subject::CalibrationDrift => "the steering residual is that of the calibration again",
            Subject::DarkDrift => "the dark readings are those of the calibration again",
        }
    }
}

/// A doubt that stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Doubt {
    /// What is doubted.
    pub subject: Subject,
    /// Time of its begin.
    pub since: Mono,
    /// What was observed, and its possible causes.
    pub text: String,
}

/// A doubt as the outputs show it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ShownDoubt {
    /// What is doubted.
    pub subject: Subject,
    /// UTC of its begin.
    pub since: String,
    /// What was observed, and its possible causes.
    pub text: String,
}

impl ShownDoubt {
    /// The doubt as a limitation of the use of poses.
    pub fn limitation(&self) -> Limitation {
        Limitation {
            grade: Grade::Limited,
            name: format!("doubt: {}", self.subject.name()),
            text: self.text.clone(),
            remedy: String::new(),
            since: Some(self.since.clone()),
            consequence: false,
        }
    }
}

/// Reads the doubts that stand.
#[derive(Clone, Debug)]
pub struct Doubts {
    standing: watch::Receiver<Vec<Doubt>>,
    /// The mean steering residual.
    pub residual: Arc<ResidualGauge>,
    /// The drift since the calibration.
    pub drift: Arc<DriftGauge>,
}

impl Doubts {
    /// The doubts that stand, in the order of their begin.
    pub fn shown(&self) -> Vec<ShownDoubt> {
        let (now, utc_ns) = read_clocks();
        let since = |doubt: &Doubt| rfc3339(utc_ns.saturating_sub(now - doubt.since));
        let show = |doubt: &Doubt| ShownDoubt {
            subject: doubt.subject,
            since: since(doubt),
            text: doubt.text.clone(),
        };
        self.standing.borrow().iter().map(show).collect()
    }

    /// Whether there is a doubt about this subject.
    pub fn stands(&self, subject: Subject) -> bool {
        self.standing.borrow().iter().any(|doubt| doubt.subject == subject)
    }
}

/// Begins and ends doubts.
#[derive(Clone, Debug)]
pub struct Doubter {
    standing: watch::Sender<Vec<Doubt>>,
    /// The mean steering residual.
    pub residual: Arc<ResidualGauge>,
    /// The drift since the calibration.
    pub drift: Arc<DriftGauge>,
}

/// Both ends, without a doubt.
pub fn pair() -> (Doubter, Doubts) {
    let (sender, receiver) = watch::channel(Vec::new());
    let residual = Arc::<ResidualGauge>::default();
    let drift = Arc::<DriftGauge>::default();
    let doubter = Doubter { standing: sender, residual: Arc::clone(&residual), drift: Arc::clone(&drift) };
    (doubter, Doubts { standing: receiver, residual, drift })
}

impl Doubter {
    /// Begins a doubt, or replaces the text of one that stands.
    pub fn begin(&self, subject: Subject, now: Mono, text: String) {
        self.standing.send_modify(|doubts| {
            if let Some(doubt) = doubts.iter_mut().find(|doubt| doubt.subject == subject) {
                doubt.text = text;
            } else {
                tracing::warn!(doubt = subject.name(), "{text}");
                doubts.push(Doubt { subject, since: now, text });
            }
        });
    }

    /// Begins a doubt with this text, or ends it without one.
    pub fn set(&self, subject: Subject, now: Mono, text: Option<String>) {
        match text {
            Some(text) => self.begin(subject, now, text),
            None => self.end(subject),
        }
    }

    /// Ends a doubt, if it stands.
    pub fn end(&self, subject: Subject) {
        self.standing.send_if_modified(|doubts| {
            let before = doubts.len();
            doubts.retain(|doubt| doubt.subject != subject);
            let ended = doubts.len() < before;
            if ended {
                tracing::info!(doubt = subject.name(), "{}", subject.end());
            }
            ended
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_doubt_keeps_its_begin_and_shows_its_newest_text() {
        let (doubter, doubts) = pair();
        assert!(!doubts.stands(Subject::Residual));
        doubter.begin(Subject::Residual, Mono(5), "one".into());
        doubter.begin(Subject::Residual, Mono(9), "two".into());
        let standing = doubts.standing.borrow().clone();
        assert_eq!(standing, [Doubt { subject: Subject::Residual, since: Mono(5), text: "two".into() }]);
        doubter.end(Subject::Residual);
        assert!(!doubts.stands(Subject::Residual) && doubts.shown().is_empty());
    }
}
