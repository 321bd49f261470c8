//! Real-time settings of the calling thread: memory lock, CPU, priority.
//!
//! A setting that the system refuses causes a warning; the daemon then runs as an ordinary process.

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};

use crate::config::RealtimeConfig;

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
            error,
            priority,
            "the fast thread has no real-time priority (realtime.priority): LimitRTPRIO is too low"
        );
    }
}

fn fifo(priority: u8) -> Result<(), String> {
    let priority = ThreadPriority::Crossplatform(priority.try_into()?);
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(thread_native_id(), priority, policy).map_err(|e| format!("{e:?}"))
}
