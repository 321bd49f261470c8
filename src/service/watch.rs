//! Detects tasks without heartbeats. Time is counted in checks, not read from a clock: if the whole process
//! or the machine stood still, only one check is missing, and no task is reported.

use trifacet_core::telemetry::heartbeat::{Heartbeats, Task};

/// Observed heartbeats of each task.
#[derive(Debug, Default)]
pub struct Watch {
    /// Heartbeats at the last check.
    seen: [u64; 3],
    /// Checks since the last heartbeat.
    silent: [u32; 3],
    /// Heartbeats when [`Watch::all_turned`] was true last.
    fed: [u64; 3],
}

impl Watch {
    /// Checks the tasks. A task without a heartbeat for `tell` checks is marked as stalled and logged. When
    /// it continues, this is logged too.
    pub fn look(&mut self, heartbeats: &Heartbeats, tell: u32) {
        for (i, task) in Task::ALL.into_iter().enumerate() {
            let turn = heartbeats.of(task);
            let count = turn.count();
            let goes_on = count != self.seen[i] || turn.ended();
            self.silent[i] = if goes_on { 0 } else { self.silent[i].saturating_add(1) };
            self.seen[i] = count;
        }
        let stalled = self.stalled(heartbeats, tell);
        for task in Task::ALL {
            let now = stalled.contains(&task);
            let before = heartbeats.of(task).mark_stalled(now);
            if now && !before {
                let within = heartbeats.of(task).inside();
                tracing::error!(%task, within_a_turn = within, "a task of the fast side stalls");
            } else if before && !now {
                tracing::warn!(%task, "the task continues");
            }
        }
    }

    /// Tasks without a heartbeat for `looks` checks. If one of them is being polled, only that one: it blocks
    /// the thread, and the others wait for it.
    pub fn stalled(&self, heartbeats: &Heartbeats, looks: u32) -> Vec<Task> {
        let silent = || Task::ALL.into_iter().zip(self.silent).filter(|(_, n)| *n >= looks).map(|(t, _)| t);
        match silent().find(|task| heartbeats.of(*task).inside()) {
            Some(task) => vec![task],
            None => silent().collect(),
        }
    }

    /// Whether every running task has had a heartbeat since this was true last.
    pub fn all_turned(&mut self, heartbeats: &Heartbeats) -> bool {
        let all = Task::ALL.into_iter().zip(self.fed).all(|(task, fed)| {
            let turn = heartbeats.of(task);
            turn.count() != fed || turn.ended()
        });
        if all {
            self.fed = Task::ALL.map(|task| heartbeats.of(task).count());
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::task::{Context, Waker};

    use trifacet_core::telemetry::heartbeat::{Heartbeat, counted};

    use super::*;

    fn turn_all(heartbeats: &Heartbeats, times: usize) {
        for task in Task::ALL {
            turn(heartbeats.of(task), times);
        }
    }

    /// Polls an idle task this number of times.
    fn turn(turn: &Heartbeat, times: usize) {
        let mut task = std::pin::pin!(counted(std::future::pending(), turn));
        for _ in 0..times {
            let _ = task.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        }
    }

    #[test]
    fn a_stalled_task_is_named_and_stops_the_watchdog_notifications() {
        let heartbeats = Heartbeats::default();
        let mut watch = Watch::default();
        for _ in 0..3 {
            turn_all(&heartbeats, 2);
            watch.look(&heartbeats, 2);
            assert!(watch.all_turned(&heartbeats) && !watch.all_turned(&heartbeats));
            assert!(heartbeats.stalled().is_empty());
        }
        for looks in 1..4 {
            turn(heartbeats.of(Task::Acquisition), 1);
            turn(heartbeats.of(Task::Estimation), 1);
            watch.look(&heartbeats, 2);
            assert!(!watch.all_turned(&heartbeats));
            let stalled = if looks < 2 { vec![] } else { vec![Task::Centering] };
            assert_eq!(heartbeats.stalled(), stalled, "{looks}");
            assert_eq!(watch.stalled(&heartbeats, 3), if looks < 3 { vec![] } else { vec![Task::Centering] });
        }
        turn_all(&heartbeats, 1);
        watch.look(&heartbeats, 2);
        assert!(watch.all_turned(&heartbeats) && heartbeats.stalled().is_empty());
    }

    #[test]
    fn the_task_that_is_inside_a_beat_is_named() {
        let heartbeats = Heartbeats::default();
        let watch = RefCell::new(Watch::default());
        let within = std::pin::pin!(counted(
            async {
                watch.borrow_mut().look(&heartbeats, 1);
                watch.borrow_mut().look(&heartbeats, 1);
                assert_eq!(heartbeats.stalled(), [Task::Estimation]);
            },
            heartbeats.of(Task::Estimation)
        ));
        let _ = within.poll(&mut Context::from_waker(Waker::noop()));
        watch.borrow_mut().look(&heartbeats, 1);
        assert_eq!(heartbeats.stalled(), [Task::Acquisition, Task::Centering], "the third has ended");
    }
}
