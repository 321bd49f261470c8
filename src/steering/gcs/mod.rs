//! Stages of PI (Physik Instrumente) that speak the General Command Set 2.0, on a serial line or TCP.
//!
//! - [`protocol`]: lines and answers; pure. [`fault`]: faults, and the error codes of the controller.
//! - `link`: the line, one query at a time. `session`: one connection. [`task`]: successive connections.
//! - [`Gcs`]: the driver for the centering task.
//!
//! The task runs on the main thread. It gets only the newest command, and the loop never waits for it. These
//! controllers have no lease: if the daemon is killed, the stage stays at its last commanded position.

pub mod fault;
mod link;
pub mod protocol;
mod session;
mod settings;
pub mod task;
mod unit;

use settings::Settings;
use task::Task;
use tokio::sync::watch;
use trifacet_core::steering::{Command, StagePosition};
use trifacet_wire::actuator::Ack;

use super::{Driver, StageEvent};
use crate::config::{GcsConfig, SteeringConfig};
use crate::exit::Failure;

/// A command, and the connection that its sender assumed.
type Addressed = (u32, Command);

/// State of the stage, as the task reports it.
#[derive(Clone, Debug, Default, PartialEq)]
struct Report {
    /// Number of connections so far; zero before the first.
    connection: u32,
    /// Reason why there is no connection at present, if known.
    down: Option<String>,
    /// Position of the stage, with the number of position reports.
    at: Option<(u64, StagePosition)>,
    /// The last acknowledgement.
    ack: Option<Ack>,
}

impl Report {
    fn up(&mut self, at: StagePosition) {
        self.connection += 1;
        self.down = None;
        self.stands(at);
    }

    fn stands(&mut self, at: StagePosition) {
        let reported = self.at.map_or(0, |(count, _)| count);
        self.at = Some((reported + 1, at));
    }
}

/// The driver of a stage with such a controller.
#[derive(Debug)]
pub struct Gcs {
    commands: watch::Sender<Option<Addressed>>,
    reports: watch::Receiver<Report>,
    /// The part of the reports that has been passed on.
    reported: Report,
}

/// The driver and its task. `steering` receives the present limits.
///
/// # Errors
/// [`crate::exit::CONFIG`] if the configuration contains no connection.
pub fn pair(config: &GcsConfig, steering: watch::Receiver<SteeringConfig>) -> Result<(Gcs, Task), Failure> {
    let settings = Settings::new(config)?;
    let (commands, commanded) = watch::channel(None);
    let unknown = Report { down: Some("no controller has answered yet".into()), ..Report::default() };
    let (reports_in, reports) = watch::channel(unknown);
    let driver = Gcs { commands, reports, reported: Report::default() };
    Ok((driver, Task { settings, steering, commands: commanded, reports: reports_in }))
}

impl Gcs {
    /// The next unreported event: a new connection first, then its results, then its end.
    fn news(&mut self) -> Option<StageEvent> {
        let report = self.reports.borrow_and_update();
        let reported = &mut self.reported;
        if report.connection != reported.connection {
            (reported.connection, reported.down) = (report.connection, None);
            return Some(StageEvent::Up);
        }
        if report.at != reported.at {
            reported.at = report.at;
            return report.at.map(|(_, at)| StageEvent::At(at));
        }
        if report.ack != reported.ack {
            reported.ack = report.ack;
            return report.ack.map(StageEvent::Ack);
        }
        if report.down != reported.down {
            reported.down.clone_from(&report.down);
            return report.down.clone().map(StageEvent::Down);
        }
        None
    }
}

impl Driver for Gcs {
    /// A command is dropped while the position of the stage is unknown.
    fn steer(&mut self, command: Command) {
        if self.reported.connection > 0 && self.reported.down.is_none() {
            self.commands.send_replace(Some((self.reported.connection, command)));
        }
    }

    async fn next(&mut self) -> StageEvent {
        loop {
            if let Some(event) = self.news() {
                return event;
            }
            if self.reports.changed().await.is_err() {
                std::future::pending::<()>().await; // the task has ended; the daemon detects that
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use trifacet_wire::actuator::LeaseAction;

    use super::*;
    use crate::config;

    fn command(id: u32) -> Command {
        Command { id, position: StagePosition([1e-6, 2e-6]), lease_ms: 200, on_expiry: LeaseAction::Hold }
    }

    #[tokio::test]
    async fn changes_are_reported_once_in_order_and_commands_need_a_stage() {
        let text = "steering.kind = 'gcs'\nsteering.gcs.address = 'stage:50000'\ntwin.steering.readback_noise_um = 'off'";
        let config = config::parse(text, None).unwrap();
        let (_steering_in, steering) = watch::channel(config.steering.clone());
        let (mut driver, task) = pair(&config.steering.gcs, steering).unwrap();
        driver.steer(command(1));
        assert_eq!(*task.commands.borrow(), None, "no connection yet");
        assert_eq!(driver.next().await, StageEvent::Down("no controller has answered yet".into()));

        task.reports.send_modify(|report| report.down = Some("unplugged".into()));
        assert_eq!(driver.next().await, StageEvent::Down("unplugged".into()));
        task.reports.send_modify(|report| report.up(StagePosition([3e-6, 4e-6])));
        assert_eq!(driver.next().await, StageEvent::Up);
        assert_eq!(driver.next().await, StageEvent::At(StagePosition([3e-6, 4e-6])));
        driver.steer(command(2));
        driver.steer(command(3));
        assert_eq!(*task.commands.borrow(), Some((1, command(3))), "the newest only");

        let ack = Ack { id: 3, accepted: true };
        task.reports.send_modify(|report| report.ack = Some(ack));
        // The same position again is a new event: the stage is still there.
        task.reports.send_modify(|report| report.stands(StagePosition([3e-6, 4e-6])));
        task.reports.send_modify(|report| report.down = Some("no answer".into()));
        assert_eq!(driver.next().await, StageEvent::At(StagePosition([3e-6, 4e-6])));
        assert_eq!(driver.next().await, StageEvent::Ack(ack));
        assert_eq!(driver.next().await, StageEvent::Down("no answer".into()));
        assert_eq!(driver.news(), None);
        driver.steer(command(4));
        assert_eq!(*task.commands.borrow(), Some((1, command(3))));
        // Down and up again between two checks: the stage may have been replaced.
        task.reports.send_modify(|report| report.up(StagePosition([0.0; 2])));
        assert_eq!(driver.next().await, StageEvent::Up);
        assert_eq!(driver.next().await, StageEvent::At(StagePosition([0.0; 2])));
        assert_eq!(driver.news(), None);
    }
}
