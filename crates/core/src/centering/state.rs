//! What the loop is told, and what it tells.

use trifacet_optics::Pose;
use trifacet_wire::LockState;

use super::lock::Transition;
use crate::centering::LoopMode;
use crate::steering::{Command, Xy};
use crate::time::Mono;

/// What the rest of the house is told of the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoopState {
    /// The lock state.
    pub lock: LockState,
    /// Where the stage was last commanded to, metres; none unless the loop has it.
    pub position: Option<Xy>,
}

impl LoopState {
    /// What may be claimed of it while the loop gets no samples, or makes no turns.
    #[must_use]
    pub fn without_observation(self) -> Self {
        // A command is no news of the stage any more: its lease runs out, and the board acts by itself.
        Self { lock: self.lock.without_observation(), position: None }
    }
}

/// What a person may want to know of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopView {
    /// What it does.
    pub mode: LoopMode,
    /// The lock state.
    pub lock: LockState,
    /// The offset of the beam in the last sample, metres; not looked at while the loop is off.
    pub offset: Option<Xy>,
    /// Velocity of the apex by the tracking filter, metres per second; with the offset.
    pub velocity: Option<Xy>,
    /// Where the stage was last commanded to, metres; none unless the loop has it.
    pub commanded: Option<Xy>,
    /// In the shadow: where the stage stands, and where the loop would send it next, metres.
    pub shadow: Option<(Xy, Xy)>,
    /// Searches in vain since it was last locked.
    pub attempts: u32,
}

/// What follows from a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// The command for the stage, unless it is not the loop's.
    pub command: Option<Command>,
    /// The sample came too late to act on it: the command holds.
    pub late: bool,
    /// The lock state has changed.
    pub transition: Option<Transition>,
}

/// A pose with the time of its sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// The pose, in the sensor's world.
    pub pose: Pose,
    /// When its signals were taken.
    pub time: Mono,
}
