//! Modes of the loop, its control target, and its action on exit.

use serde::{Deserialize, Serialize};
use trifacet_wire::actuator::LeaseAction;

/// The quantity that the loop brings to zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// The offset between beam and apex, computed with the wedges of the facets at the last valid pose.
    Apex,
    /// The differences between the three powers, as in section 2.1 of the paper.
    Balance,
}

/// Mode of the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LoopMode {
    /// The loop moves the stage.
    On,
    /// The loop does nothing.
    Off,
    /// The loop computes its next command and reports it, but moves nothing. For commissioning.
    Shadow,
    /// The operator moves the stage.
    Manual,
}

impl LoopMode {
    /// Every mode.
    pub const ALL: [LoopMode; 4] = [LoopMode::On, LoopMode::Off, LoopMode::Shadow, LoopMode::Manual];

    /// Name of the mode, as in commands and configuration: "on", "shadow".
    pub fn name(self) -> &'static str {
        match self {
            LoopMode::On => "on",
            LoopMode::Off => "off",
            LoopMode::Shadow => "shadow",
            LoopMode::Manual => "manual",
        }
    }
}

/// What the steering does when the daemon ends, or when the lease of a command expires.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnExit {
    /// Stays at its position.
    Hold,
    /// Moves to the parking position.
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
