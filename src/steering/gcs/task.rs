//! The task of a controller: keeps a session open, and opens another one when it ends. Runs on the main
//! thread, at the speed of the controller.

use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{Interval, MissedTickBehavior, interval, sleep};
use trifacet_core::steering::{Command, StagePosition};
use trifacet_core::telemetry::Counters;
use trifacet_wire::actuator::Ack;

use super::fault::{FINE, Fault, OUT_OF_LIMITS, context};
use super::session::{Session, rounded_um};
use super::settings::Settings;
use super::{Addressed, Report};
use crate::config::SteeringConfig;

/// Interval of the position queries.
const READBACK: Duration = Duration::from_millis(50);
/// Pause between two attempts: shortest and longest.
const PAUSE: [Duration; 2] = [Duration::from_millis(200), Duration::from_secs(5)];
/// Tolerance of the limits for rounding, metres.
const DUST: f64 = 1e-9;

/// The stage with its controller, and the ends of its channels.
pub struct Task {
    pub(super) settings: Settings,
    /// The limits, which may change while the daemon runs.
    pub(super) steering: watch::Receiver<SteeringConfig>,
    pub(super) commands: watch::Receiver<Option<Addressed>>,
    pub(super) reports: watch::Sender<Report>,
}

impl Task {
    /// Runs until the driver is dropped: by then its last command was acknowledged, or given up.
    pub async fn run(mut self, counters: &Counters) {
        let reports = self.reports.clone();
        tokio::select! {
            biased;
            () = reports.closed() => {}
            never = self.keep(counters) => match never {},
        }
    }

    async fn keep(&mut self, counters: &Counters) -> std::convert::Infallible {
        let settings = self.settings.clone();
        let mut pause = PAUSE[0];
        loop {
            let Err(fault) = self.converse(&settings, &mut pause, counters).await;
            self.reports.send_modify(|report| report.down = Some(fault.to_string()));
            sleep(pause).await;
            pause = (2 * pause).min(PAUSE[1]);
        }
    }

    /// One session from its start to its end. `pause` is reset when a command is accepted.
    async fn converse(
        &mut self,
        settings: &Settings,
        pause: &mut Duration,
        counters: &Counters,
    ) -> Result<std::convert::Infallible, Fault> {
        let limits = self.steering.borrow_and_update().clone();
        let mut session = Session::open(settings, &limits).await?;
        let mut at = session.position().await?;
        tracing::info!(position_um = ?at.map(rounded_um), "steering stage is up");
        self.reports.send_modify(|report| report.up(at));
        let mut readback = readback();
        loop {
            tokio::select! {
                biased;
                _ = readback.tick() => {
                    let stands = session.position().await?;
                    self.reports.send_modify(|report| report.stands(stands));
                }
                Ok(()) = self.steering.changed() => {
                    let limits = self.steering.borrow_and_update().clone();
                    session.check_travel(&limits)?;
                }
                Ok(()) = self.commands.changed() => {
                    let Some((connection, command)) = *self.commands.borrow_and_update() else { continue };
                    // A command for an earlier connection was computed from an outdated position.
                    if connection != self.reports.borrow().connection {
                        continue;
                    }
                    counters.commands_sent.inc();
                    let accepted = self.obey(&mut session, command, at).await?;
                    if accepted {
                        (at, *pause) = (command.position, PAUSE[0]);
                    } else {
                        counters.commands_refused.inc();
                    }
                    let ack = Ack { id: command.id, accepted };
                    self.reports.send_modify(|report| report.ack = Some(ack));
                }
            }
        }
    }

    /// Sends the stage to the commanded position if it may go there; returns whether it goes.
    async fn obey(
        &self,
        session: &mut Session<'_>,
        command: Command,
        at: StagePosition,
    ) -> Result<bool, Fault> {
        let limit = self.steering.borrow().limit_um * 1e-6;
        let position = command.position;
        if !(session.reaches(position) && allowed(position, at, limit)) {
            tracing::error!(?position, limit, "internal error: a command beyond the limits was not sent");
            return Ok(false);
        }
        match session.go(position).await? {
            Some((_, FINE)) => Ok(true),
            Some((asked, code @ OUT_OF_LIMITS)) => {
                if self.reports.borrow().ack.is_none_or(|last| last.accepted) {
                    tracing::error!(asked, code, "the steering stage refuses: {}", context(code));
                }
                Ok(false)
            }
            Some((asked, code)) => Err(Fault::Refused { asked, code }),
            None => Ok(false),
        }
    }
}

/// Whether the position is within the limits, or on the way back for a stage beyond them. False for NaN.
fn allowed(position: StagePosition, at: StagePosition, limit: f64) -> bool {
    position.iter().zip(at).all(|(to, at)| (-limit.max(-at) - DUST..=limit.max(at) + DUST).contains(to))
}

fn readback() -> Interval {
    let mut interval = interval(READBACK);
    // After a slow answer, commands come first.
    interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
    interval.reset();
    interval
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beyond_the_limits_only_motions_back_are_allowed() {
        for (to, at, fine) in [
            ([3e-4, -4e-4], [0.0; 2], true),
            ([4.1e-4, 0.0], [0.0; 2], false),
            ([4.5e-4, 0.0], [5e-4, 0.0], true),
            ([5.1e-4, 0.0], [5e-4, 0.0], false),
            ([0.0, -4.5e-4], [0.0, -5e-4], true),
            ([0.0, 4.5e-4], [0.0, -5e-4], false),
            ([f64::NAN, 0.0], [0.0; 2], false),
            ([0.0, f64::INFINITY], [0.0; 2], false),
        ] {
            assert_eq!(allowed(StagePosition(to), StagePosition(at), 4e-4), fine, "{to:?} from {at:?}");
        }
    }
}
