//! What the loop does, what it regulates, and how it leaves the stage.

use serde::{Deserialize, Serialize};
use trifacet_wire::actuator::LeaseAction;

/// What the loop brings to zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// The offset between beam and apex, by the wedges of the last pose.
    Apex,
    /// The differences between the three powers, as in the paper.
    Balance,
}

/// What the loop does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LoopMode {
    /// It moves the stage.
    On,
    /// It does nothing.
    Off,
    /// It computes what it would do, reports it, and moves nothing: for the first contact with hardware.
    Shadow,
    /// The stage stands where a person puts it.
    Manual,
}

impl LoopMode {
    /// Every mode.
    pub const ALL: [LoopMode; 4] = [LoopMode::On, LoopMode::Off, LoopMode::Shadow, LoopMode::Manual];

    /// The mode as a word: "on", "shadow".
    pub fn name(self) -> &'static str {
        match self {
            LoopMode::On => "on",
            LoopMode::Off => "off",
            LoopMode::Shadow => "shadow",
            LoopMode::Manual => "manual",
        }
    }
}

/// What the steering does when the daemon ends, or the lease of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnExit {
    /// Stays where it is.
    Hold,
    /// Goes to the parking position.
    Park,
}

impl From<OnExit> for LeaseAction {
    fn from(on_exit: OnExit) -> Self {
        match on_exit {
            OnExit::Hold => Self::Hold,
            OnExit::Park => Self::Park,
        }
    }
}
