//! Supervision of the tasks, with and without systemd.
//!
//! - [`notify`]: the messages to systemd (`sd_notify`).
//! - [`watch`]: detects tasks without heartbeats; pure.
//! - [`Service`]: the task, on the main thread, a few times a second.

pub mod notify;
pub mod watch;

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
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
use crate::grade::{Evidence, HOLD_S};

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
    recent: RefCell<Recent>,
}

impl Service {
    /// Supervises the daemon with these heartbeats and frames.
    pub fn new(config: &RealtimeConfig, heartbeats: Arc<Heartbeats>, glance: Arc<LatestStatus>) -> Self {
        let patience = (config.stall_ms > 0).then(|| Duration::from_millis(config.stall_ms.into()));
        let notify = Notify::from_environment();
        Self { notify, heartbeats, glance, patience, ending: Cell::new(false), recent: RefCell::default() }
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
            self.tell(watch.all_turned(&self.heartbeats), ticks(Duration::from_secs_f64(HOLD_S)));
            let stalled = patience.map_or_else(Vec::new, |ticks| watch.stalled(&self.heartbeats, ticks));
            if !stalled.is_empty() {
                let ms = self.patience.unwrap_or_default().as_millis();
                let why =
                    format!("task {} stalls: no heartbeat for {ms} ms (realtime.stall_ms)", list(&stalled));
                return Failure::new(exit::SOFTWARE, why);
            }
        }
    }

    /// `held`: the number of checks for which a status bit counts.
    fn tell(&self, alive: bool, held: u32) {
        if alive {
            self.notify.alive();
        }
        if let Some(newest) = self.glance.newest() {
            self.notify.ready();
            let lately = self.recent.borrow_mut().push(newest.0, held as usize);
            self.notify.status(&line(newest, lately, &self.heartbeats.stalled()));
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

/// The statuses of the last checks.
#[derive(Debug, Default)]
struct Recent(VecDeque<Status>);

impl Recent {
    /// Adds the status of this check, and returns all bits of the last `checks` checks.
    fn push(&mut self, status: Status, checks: usize) -> Status {
        self.0.push_back(status);
        while self.0.len() > checks {
            self.0.pop_front();
        }
        self.0.iter().fold(Status::default(), |bits, status| bits | *status)
    }
}

/// The grade and the most important state, as a line for `systemctl status`.
fn line((status, lock): (Status, LockState), lately: Status, stalled: &[Task]) -> String {
    let stalled = (!stalled.is_empty()).then(|| format!("task {} stalls", list(stalled)));
    let lately = Status(lately.0 & !Status::POSE_VALID.0);
    let evidence =
        Evidence { status: Some(status), lately, lock, stalled: stalled.as_deref(), ..Evidence::default() };
    let now = evidence.assess(Vec::new(), |_| None);
    format!("{}: {}", now.grade.name(), now.headline)
}

/// Names of tasks, separated by commas.
fn list(tasks: &[Task]) -> String {
    tasks.iter().map(|task| task.name()).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_status_line_states_the_grade_and_its_reason() {
        let fine = (Status::POSE_VALID | Status::STEERING_MEASURED, LockState::Locked);
        let none = Status::default();
        assert_eq!(line(fine, none, &[]), "good: Pose valid, beam locked");
        let dark = (Status::PSD_A_LOW | Status::PSD_C_LOW | Status::SIMULATED, LockState::Lost);
        assert_eq!(line(dark, none, &[]), "bad: No valid pose: too little light on PSD A, C");
        let replayed = (fine.0 | Status::REPLAYED, fine.1);
        assert_eq!(line(replayed, none, &[]), "limited: Replay: pose valid, beam locked");
        let stalled = line(fine, none, &[Task::Centering]);
        assert_eq!(stalled, "bad: Pose valid, beam locked: task centering stalls");
    }

    #[test]
    fn a_bit_of_one_check_stays_for_some_checks() {
        let mut recent = Recent::default();
        let bits = [Status::PSD_A_LOW, Status::POSE_VALID, Status::POSE_VALID, Status::POSE_VALID]
            .map(|status| recent.push(status, 3).has(Status::PSD_A_LOW));
        assert_eq!(bits, [true, true, true, false]);
    }
}
