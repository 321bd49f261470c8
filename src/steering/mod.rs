//! Stages that steer the laser: two axes, behind one trait.
//!
//! - [`configured`]: the stage of the configuration. [`Driver`]: takes the newest command, and reports events
//!   of the stage.
//! - [`outputs`]: the two outputs of the board or of the twin, on the connection of the samples.
//! - [`gcs`]: stages of PI with a controller of their own.
//!
//! Positions are those of the axes of the stage, metres. The map to the beam is
//! [`trifacet_core::steering::BeamMap`].

pub mod gcs;
pub mod outputs;

use std::future::Future;

pub use gcs::Gcs;
pub use outputs::{OutputLink, Outputs};
use tokio::sync::watch;
use trifacet_core::steering::{Command, StagePosition};
use trifacet_core::telemetry::Counters;
use trifacet_wire::actuator::Ack;

use crate::config::{Config, NO_TILT, SteeringConfig, SteeringKind};
use crate::exit::{self, Failure};

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

/// The configured stage, in its parts.
pub struct Stage {
    /// The driver, for whoever commands the stage.
    pub driver: StageDriver,
    /// The task that must run on an ordinary thread; `None` if the source drives the stage.
    pub task: Option<StageTask>,
    /// For the source. Never carries a command if the stage is not at the outputs of the source.
    pub outputs: OutputLink,
}

/// The stage that `steering.kind` selects. `limits` receives the present limits.
///
/// # Errors
/// [`crate::exit::CONFIG`] if the configuration does not describe a connection to the stage, or the stage tilts the
/// beam.
pub fn configured(config: &Config, limits: watch::Receiver<SteeringConfig>) -> Result<Stage, Failure> {
    let (at_outputs, outputs) = outputs::pair(config.steering.full_scale_um * 1e-6);
    let (driver, task) = match config.steering.kind {
        SteeringKind::Outputs => (StageDriver::Outputs(at_outputs), None),
        SteeringKind::Gcs => {
            let (driver, task) = gcs::pair(&config.steering.gcs, limits)?;
            (StageDriver::Gcs(driver), Some(StageTask::Gcs(task)))
        }
        SteeringKind::Tilt => return Err(Failure::new(exit::CONFIG, NO_TILT)),
    };
    Ok(Stage { driver, task, outputs })
}

/// The task of a stage that the source does not drive.
pub enum StageTask {
    /// A stage of PI.
    Gcs(gcs::task::Task),
}

impl StageTask {
    /// Runs until the driver is dropped, and its last command was acknowledged or given up.
    pub async fn run(self, counters: &Counters) {
        match self {
            Self::Gcs(task) => task.run(counters).await,
        }
    }
}

/// The driver of the configured stage.
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
