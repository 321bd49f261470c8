//! Heartbeats of the tasks of the fast side: they show that each task is running, with or without samples.
//!
//! A heartbeat is one poll of the task's future. Every task has a timer and therefore beats without samples,
//! too. A task that waits for something that never comes does not beat. A task that blocks within a poll
//! stops all tasks of the thread. A heartbeat costs three relaxed stores.

use std::fmt;
use std::future::poll_fn;
use std::pin::pin;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64};
use std::task::Poll;
use std::time::Duration;

/// An idle task beats at least this often.
pub const HEARTBEAT: Duration = Duration::from_millis(20);

/// A task of the fast side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// From the source to samples.
    Acquisition,
    /// The loop that keeps the beam on the apex.
    Centering,
    /// From samples to poses, and their publishing.
    Estimation,
}

impl Task {
    /// All tasks, in the order of the data flow.
    pub const ALL: [Task; 3] = [Task::Acquisition, Task::Centering, Task::Estimation];

    /// The name of the task: "acquisition".
    pub fn name(self) -> &'static str {
        match self {
            Task::Acquisition => "acquisition",
            Task::Centering => "centering",
            Task::Estimation => "estimation",
        }
    }
}

impl fmt::Display for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Faults that can be injected into a task, to test whether they are detected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Drill {
    /// The task waits for ever; the others continue.
    Stall = 1,
    /// The task blocks within a poll; the others wait for it.
    Block = 2,
    /// The task ends.
    End = 3,
}

impl Drill {
    /// All drills.
    pub const ALL: [Drill; 3] = [Drill::Stall, Drill::Block, Drill::End];

    /// The name of the drill: "stall".
    pub fn name(self) -> &'static str {
        match self {
            Drill::Stall => "stall",
            Drill::Block => "block",
            Drill::End => "end",
        }
    }
}

/// The heartbeats of every task. Shared, lock-free.
#[derive(Debug, Default)]
pub struct Heartbeats([Heartbeat; 3]);

impl Heartbeats {
    /// The heartbeats of a task.
    pub fn of(&self, task: Task) -> &Heartbeat {
        &self.0[task as usize]
    }

    /// The tasks that are marked as stalled; empty in normal operation.
    pub fn stalled(&self) -> Vec<Task> {
        Task::ALL.into_iter().filter(|task| self.of(*task).stalled.load(Relaxed)).collect()
    }
}

/// The heartbeats of one task.
#[derive(Debug, Default)]
pub struct Heartbeat {
    /// Counts the starts and ends of polls: odd within a poll.
    transitions: AtomicU64,
    ended: AtomicBool,
    /// Set by the task that monitors the heartbeats.
    stalled: AtomicBool,
    drill: AtomicU8,
}

impl Heartbeat {
    /// Heartbeats begun so far.
    pub fn count(&self) -> u64 {
        self.transitions.load(Relaxed).div_ceil(2)
    }

    /// Whether the task is within a poll.
    pub fn inside(&self) -> bool {
        self.transitions.load(Relaxed) % 2 == 1
    }

    /// Whether the task has ended.
    pub fn ended(&self) -> bool {
        self.ended.load(Relaxed)
    }

    /// Marks the task as stalled or not; returns the previous mark. For the task that monitors the
    /// heartbeats.
    pub fn mark_stalled(&self, stalled: bool) -> bool {
        self.stalled.swap(stalled, Relaxed)
    }

    /// Whether the task is marked as stalled.
    pub fn stalled(&self) -> bool {
        self.stalled.load(Relaxed)
    }

    /// Injects a fault into the task.
    pub fn drill(&self, drill: Drill) {
        self.drill.store(drill as u8, Relaxed);
    }

    fn edge(&self) {
        // Only the task itself writes.
        self.transitions.store(self.transitions.load(Relaxed) + 1, Relaxed);
    }
}

/// Runs a task to its end, and counts its heartbeats.
pub async fn counted(task: impl Future<Output = ()>, turn: &Heartbeat) {
    let mut task = pin!(task);
    poll_fn(|context| {
        let drill = turn.drill.load(Relaxed);
        if drill == Drill::Stall as u8 {
            return Poll::Pending; // a wake-up is no heartbeat while the task stalls
        }
        turn.edge();
        while turn.drill.load(Relaxed) == Drill::Block as u8 {
            std::thread::sleep(HEARTBEAT);
        }
        let poll = if drill == Drill::End as u8 { Poll::Ready(()) } else { task.as_mut().poll(context) };
        turn.edge();
        poll
    })
    .await;
    turn.ended.store(true, Relaxed);
}

#[cfg(test)]
mod tests {
    use tokio::task::yield_now;

    use super::*;

    #[tokio::test]
    async fn every_poll_is_a_beat_until_the_end() {
        let heartbeats = Heartbeats::default();
        let turn = heartbeats.of(Task::Centering);
        let task = async {
            for n in 1..=5 {
                assert!(turn.inside() && turn.count() == n, "{turn:?}");
                yield_now().await;
            }
        };
        counted(task, turn).await;
        assert!(!turn.inside() && turn.ended());
        assert_eq!((turn.count(), heartbeats.of(Task::Estimation).count()), (6, 0));
    }

    #[tokio::test]
    async fn a_drill_ends_a_task_or_its_beats() {
        let turn = Heartbeat::default();
        turn.drill(Drill::End);
        counted(std::future::pending(), &turn).await;
        assert!(turn.ended());

        let turn = Heartbeat::default();
        turn.drill(Drill::Stall);
        let beating = async {
            loop {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        };
        let wait = Duration::from_millis(20);
        assert!(tokio::time::timeout(wait, counted(beating, &turn)).await.is_err());
        assert!(!turn.inside() && !turn.ended() && turn.count() <= 2, "{turn:?}");
    }
}
