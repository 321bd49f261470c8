//! Inputs and outputs of the loop.

use trifacet_optics::Pose;
use trifacet_wire::LockState;

use super::lock::Transition;
use crate::centering::{CommandBacklog, LoopMode};
use crate::steering::{BeamOffset, Command, StagePosition};
use crate::time::Mono;

/// State of the loop for the frames and the other parts of the daemon.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoopState {
    /// The lock state.
    pub lock: LockState,
    /// Last commanded position of the stage, metres; `None` while the loop does not control the stage.
    pub position: Option<StagePosition>,
}

impl LoopState {
    /// The state to report while the loop gets no samples, or while its task is stalled.
    #[must_use]
    pub fn without_observation(self) -> Self {
        // The last command no longer shows where the stage is: its lease expires, and the board acts on its
        // own.
        Self { lock: self.lock.without_observation(), position: None }
    }
}

/// State of the loop for the operator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopView {
    /// Mode of the loop.
    pub mode: LoopMode,
    /// The lock state.
    pub lock: LockState,
    /// Offset of the beam in the last sample, metres; `None` while the loop is off or no offset is known.
    pub offset: Option<BeamOffset>,
    /// Velocity of the apex from the tracking filter, metres per second; `None` without an offset.
    pub velocity: Option<BeamOffset>,
    /// Last commanded position of the stage, metres; `None` while the loop does not control the stage.
    pub commanded: Option<StagePosition>,
    /// In shadow mode: the position of the stage, and the position that the loop would command next, metres.
    pub shadow: Option<(StagePosition, StagePosition)>,
    /// Failed searches since the last lock.
    pub attempts: u32,
    /// The commands that the stage has not acknowledged.
    pub backlog: CommandBacklog,
    /// Measured delay from a sample to the first one that has its command applied, seconds, if it is known.
    pub delay_s: Option<f64>,
}

/// Result of one sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Command for the stage; `None` while the loop does not control the stage.
    pub command: Option<Command>,
    /// The sample was too old to act on; the command holds the stage.
    pub late: bool,
    /// The change of the lock state, if the sample caused one.
    pub transition: Option<Transition>,
}

/// A pose with the time of its sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// The pose, in the world frame of the head.
    pub pose: Pose,
    /// Time at which its signals were sampled.
    pub time: Mono,
}

/// Why the loop refuses a request of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LoopRefusal {
    /// A recording is the source.
    #[error("a recording is replayed: there is no stage to steer")]
    NoStage,
    /// A move needs manual mode.
    #[error("the stage can be moved manually only while the loop is \"manual\"")]
    NotManual,
    /// A search needs mode on.
    #[error("the loop searches for the apex only while it is \"on\"")]
    NotOn,
    /// The configuration disables searches.
    #[error("centering.search is false")]
    SearchDisabled,
}
