//! What moves the laser: stages of two axes, behind one trait.
//!
//! - [`Driver`]: takes the newest command, tells what the stage says.
//! - [`map`]: the steering matrix, what a movement of the stage does to the beam.
//! - [`outputs`]: the two outputs of the board, or of the twin, which go the way of the samples back.
//! - [`gcs`]: stages of PI at a controller of their own.
//!
//! Positions are those of the stage's axes, metres.

pub mod gcs;
pub mod outputs;

use std::future::Future;

pub use gcs::Gcs;
pub use outputs::Outputs;
use trifacet_core::steering::{Command, Xy};
use trifacet_wire::actuator::Ack;

/// What a driver reports.
#[derive(Clone, Debug, PartialEq)]
pub enum StageEvent {
    /// The stage is there, perhaps again, or another one: it may stand anywhere.
    Up,
    /// The stage's answer to a command.
    Ack(Ack),
    /// Where the stage says that it stands, metres. Stages whose position comes with the samples do
    /// not report it.
    At(Xy),
    /// The stage does not take commands, for this reason. The driver keeps trying by itself.
    Down(String),
}

/// A stage that takes positions.
pub trait Driver {
    /// Takes the newest command; an older one not yet sent is dropped. Never waits.
    fn steer(&mut self, command: Command);

    /// The next thing to know. Cancel-safe: dropping the future loses nothing.
    fn next(&mut self) -> impl Future<Output = StageEvent>;
}

/// The stage of the configuration.
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
