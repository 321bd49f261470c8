//! The time in which a process waits for a CPU, which time limits of tests must exclude.

/// Time for which threads of a process were ready to run and had no CPU, nanoseconds; zero where the kernel
/// does not count it, or the process is gone.
pub(crate) fn waited_ns(pid: u32) -> i64 {
    let Ok(tasks) = std::fs::read_dir(format!("/proc/{pid}/task")) else { return 0 };
    tasks.filter_map(|task| waited(&task.ok()?.path().join("schedstat"))).sum()
}

/// The second of three numbers: time on a CPU, time on a run queue, number of time slices.
fn waited(file: &std::path::Path) -> Option<i64> {
    std::fs::read_to_string(file).ok()?.split_whitespace().nth(1)?.parse().ok()
}
