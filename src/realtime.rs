//! Real-time settings of the calling thread: memory lock, CPU, priority.
//!
//! A setting that the system refuses causes a warning; the daemon then runs as an ordinary process.

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use crate::config::RealtimeConfig;

/// Why the thread does not get a real-time priority.
#[derive(Debug, thiserror::Error)]
enum PriorityError {
    /// The priority is outside the range of the system.
    #[error("The value is not in the range of [{}; {}]", ThreadPriorityValue::MIN, ThreadPriorityValue::MAX)]
    Range,
    /// The system refuses the priority.
    #[error("{0:?}")]
    Refused(thread_priority::Error),
}

/// Applies the settings to the calling thread (the memory lock: to the whole process).
pub fn apply(config: &RealtimeConfig) {
    if config.lock_memory
        && let Err(error) = mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)
    {
        tracing::warn!(%error, "memory is not locked (realtime.lock_memory): LimitMEMLOCK is too low");
    }
    if let Some(cpu) = config.cpu {
        let mut cpus = CpuSet::new();
        cpus.set(cpu);
        if let Err(error) = sched_setaffinity(None, &cpus) {
            tracing::warn!(%error, cpu, "the fast thread is not pinned (realtime.cpu)");
        }
    }
    if config.priority > 0
        && let Err(error) = fifo(config.priority)
    {
        let priority = config.priority;
        tracing::warn!(
            error = error.to_string(),
            priority,
            "the fast thread has no real-time priority (realtime.priority): LimitRTPRIO is too low"
        );
    }
}

fn fifo(priority: u8) -> Result<(), PriorityError> {
    let priority = priority.try_into().map_err(|_| PriorityError::Range)?;
    let priority = ThreadPriority::Crossplatform(priority);
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(thread_native_id(), priority, policy).map_err(PriorityError::Refused)
}
