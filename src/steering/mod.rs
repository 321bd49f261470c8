//! Stages that steer the laser: two axes, behind one trait.
//!
//! - [`Driver`]: takes the newest command, and reports events of the stage.
//! - [`outputs`]: the two outputs of the board or of the twin, on the connection of the samples.
//! - [`gcs`]: stages of PI with a controller of their own.
//!
//! Positions are those of the axes of the stage, metres. The map to the beam is
//! [`trifacet_core::steering::BeamMap`].

pub mod gcs;
pub mod outputs;

use std::future::Future;

pub use gcs::Gcs;
pub use outputs::Outputs;
use trifacet_core::steering::{Command, StagePosition};
use trifacet_wire::actuator::Ack;

/// Events of a driver.
#[derive(Clone, Debug, PartialEq)]
pub enum StageEvent {
    /// The stage is ready, possibly after a fault or as a replacement: its position is unknown.
    Up,
    /// Acknowledgement of a command.
    Ack(Ack),
    /// Position that the stage reports, metres. Not used by stages whose position is part of the samples.
    At(StagePosition),
    /// The stage does not take commands, for this reason. The driver keeps trying on its own.
    Down(String),
}

/// A driver of a stage.
pub trait Driver {
    /// Takes the newest command; an older one that has not been sent yet is dropped. Never waits.
    fn steer(&mut self, command: Command);

    /// The next event. Cancel-safe: dropping the future loses nothing.
    fn next(&mut self) -> impl Future<Output = StageEvent>;
}

/// The configured stage.
#[derive(Debug)]
pub enum StageDriver {
    /// The outputs of the board or the twin.
    Outputs(Outputs),
    /// A stage of PI.
    Gcs(Gcs),
}

impl Driver for StageDriver {
    fn steer(&mut self, command: Command) {
        match self {
            Self::Outputs(outputs) => outputs.steer(command),
            Self::Gcs(gcs) => gcs.steer(command),
        }
    }

    async fn next(&mut self) -> StageEvent {
        match self {
            Self::Outputs(outputs) => outputs.next().await,
            Self::Gcs(gcs) => gcs.next().await,
        }
    }
}
