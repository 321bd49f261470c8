//! Supervision of the tasks, with and without systemd.
//!
//! - [`notify`]: the messages to systemd (`sd_notify`).
//! - [`watch`]: detects tasks without heartbeats; pure.
//! - [`Service`]: the task, on the main thread, a few times a second.

pub mod notify;
pub mod watch;

use std::cell::Cell;
use std::sync::Arc;
use std::time::Duration;

pub use notify::Notify;
use tokio::time::{MissedTickBehavior, interval};
use trifacet_core::telemetry::LatestStatus;
use trifacet_core::telemetry::heartbeat::{Heartbeats, Task};
use trifacet_wire::{LockState, Status};
use watch::Watch;

use crate::config::RealtimeConfig;
use crate::exit::{self, Failure};

/// Longest interval between checks.
const TICK: Duration = Duration::from_millis(250);
/// Time without a heartbeat after which a task is reported as stalled, unless a limit requires less.
const TELL: Duration = Duration::from_secs(1);
/// Time limit for an orderly end.
const END: Duration = Duration::from_secs(8);

/// The supervision on the main thread.
#[derive(Debug)]
pub struct Service {
    /// Messages to systemd.
    pub notify: Notify,
    heartbeats: Arc<Heartbeats>,
    glance: Arc<LatestStatus>,
    /// `realtime.stall_ms`; `None` for 0.
    patience: Option<Duration>,
    ending: Cell<bool>,
}

impl Service {
    /// Supervises the daemon with these heartbeats and frames.
    pub fn new(config: &RealtimeConfig, heartbeats: Arc<Heartbeats>, glance: Arc<LatestStatus>) -> Self {
        let patience = (config.stall_ms > 0).then(|| Duration::from_millis(config.stall_ms.into()));
        let notify = Notify::from_environment();
        Self { notify, heartbeats, glance, patience, ending: Cell::new(false) }
    }

    /// Notes that the daemon is stopping. From now on tasks need no heartbeats, but must end in time.
    pub fn ending(&self) {
        self.notify.stopping();
        self.ending.set(true);
    }

    /// Reports to systemd: the first frame, the status in the newest frame, and heartbeats of all tasks.
    /// Returns when a task has had none for too long, or when the end takes too long.
    pub async fn run(&self) -> Failure {
        let half = || [self.notify.watchdog(), self.patience].into_iter().flatten().map(|limit| limit / 2);
        let tick = half().fold(TICK, Duration::min);
        let ticks = |time: Duration| time.as_nanos().div_ceil(tick.as_nanos()) as u32;
        let (tell, patience, end) =
            (ticks(half().fold(TELL, Duration::min)), self.patience.map(ticks), ticks(END));
        let mut watch = Watch::default();
        let mut ending = 0;
        let mut looks = interval(tick);
        // Time in which this thread did not run is not counted against the tasks.
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            looks.tick().await;
            if self.ending.get() {
                self.notify.alive();
                ending += 1;
                if ending > end {
                    return self.endless();
                }
                continue;
            }
            watch.look(&self.heartbeats, tell);
            self.tell(watch.all_turned(&self.heartbeats));
            let stalled = patience.map_or_else(Vec::new, |ticks| watch.stalled(&self.heartbeats, ticks));
            if !stalled.is_empty() {
                let ms = self.patience.unwrap_or_default().as_millis();
                let why =
                    format!("task {} stalls: no heartbeat for {ms} ms (realtime.stall_ms)", list(&stalled));
                return Failure::new(exit::SOFTWARE, why);
            }
        }
    }

    fn tell(&self, alive: bool) {
        if alive {
            self.notify.alive();
        }
        if let Some(newest) = self.glance.newest() {
            self.notify.ready();
            self.notify.status(&line(newest, &self.heartbeats.stalled()));
        }
    }

    fn endless(&self) -> Failure {
        let running: Vec<_> =
            Task::ALL.into_iter().filter(|task| !self.heartbeats.of(*task).ended()).collect();
        let what =
            if running.is_empty() { "clients are".into() } else { format!("task {} is", list(&running)) };
        Failure::new(
            exit::SOFTWARE,
            format!("{} s after the stop request, {what} still running", END.as_secs()),
        )
    }
}

/// The status in the newest frame, as a line for `systemctl status`.
fn line((status, lock): (Status, LockState), stalled: &[Task]) -> String {
    let reasons = Status(status.0 & Status::FATAL.0).names().collect::<Vec<_>>().join(" ");
    let poses = match reasons.as_str() {
        _ if status.has(Status::POSE_VALID) => "poses are valid".into(),
        "" => "no pose: samples are missing".into(),
        reasons => format!("no pose: {reasons}"),
    };
    let simulated = if status.has(Status::SIMULATED) { " (simulated)" } else { "" };
    let replayed = if status.has(Status::REPLAYED) { " (replayed)" } else { "" };
    let line = format!("{}, {poses}{simulated}{replayed}", lock.name());
    if stalled.is_empty() { line } else { format!("task {} stalls; before that: {line}", list(stalled)) }
}

/// Names of tasks, separated by commas.
fn list(tasks: &[Task]) -> String {
    tasks.iter().map(|task| task.name()).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_status_line_states_the_state_and_its_reason() {
        let fine = (Status::POSE_VALID | Status::UNCALIBRATED, LockState::Locked);
        assert_eq!(line(fine, &[]), "locked, poses are valid");
        let dark = (Status::PSD_A_LOW | Status::PSD_C_LOW | Status::SIMULATED, LockState::Lost);
        assert_eq!(line(dark, &[]), "lost, no pose: PSD_A_LOW PSD_C_LOW (simulated)");
        let replayed = (fine.0 | Status::REPLAYED, fine.1);
        assert_eq!(line(replayed, &[]), "locked, poses are valid (replayed)");
        let stalled = line(fine, &[Task::Centering]);
        assert_eq!(stalled, "task centering stalls; before that: locked, poses are valid");
    }
}
