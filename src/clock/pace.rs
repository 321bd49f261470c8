//! Real-time pacing: samples become due on an absolute schedule.
//!
//! Tokio's timers have a resolution of one millisecond. Here a `timerfd` wakes the task to within some
//! microseconds. No sample is skipped: a task that was late gets all samples that have become due.

use std::future::Future;
use std::io;
use std::num::NonZeroU64;
use std::os::fd::OwnedFd;

use rustix::thread::set_current_timer_slack;
use rustix::time::{
    Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec, timerfd_create, timerfd_settime,
};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;
use trifacet_core::time::{Clock, Mono, NS_PER_S};

use super::SystemClock;

/// Waits for a time of one clock.
pub trait Timer {
    /// Returns at `moment`, or at once if that time has passed. Cancel-safe.
    ///
    /// # Errors
    /// The system timer fails.
    fn until(&mut self, moment: Mono) -> impl Future<Output = io::Result<()>>;
}

/// A clock with a timer.
pub trait Waiting: Clock {
    /// Type of the timer.
    type Timer: Timer;

    /// A timer of this clock. The timer of the system clock must be created on the thread and in the tokio
    /// runtime that use it.
    ///
    /// # Errors
    /// The system provides no timer.
    fn timer(&self) -> io::Result<Self::Timer>;
}

/// The times `start + k / rate`, each computed from `k` so that rounding errors do not accumulate.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    start: Mono,
    rate_hz: f64,
}

impl Schedule {
    /// A schedule with sample 0 at `start`; the rate must be above 0.
    pub fn new(start: Mono, rate_hz: f64) -> Self {
        Self { start, rate_hz }
    }

    /// Time at which sample `k` is due, to the nanosecond.
    pub fn time(&self, k: u64) -> Mono {
        let ns = (k as f64 / self.rate_hz * NS_PER_S as f64).round();
        Mono(self.start.0.saturating_add(ns as i64))
    }

    /// Number of samples that have become due since the start.
    pub fn count(&self, now: Mono) -> u64 {
        // The estimate may be off by one if `now` is the due time of a sample; `time` decides.
        let mut n = (now.seconds_since(self.start) * self.rate_hz) as u64;
        while n > 0 && self.time(n - 1) > now {
            n -= 1;
        }
        while self.time(n) <= now {
            n += 1;
        }
        n
    }
}

/// Reports when samples are due.
pub struct Pace<C: Waiting> {
    clock: C,
    timer: C::Timer,
    schedule: Schedule,
    delivered: u64,
}

impl<C: Waiting> Pace<C> {
    /// Starts now, with the first sample.
    ///
    /// # Errors
    /// The system provides no timer.
    pub fn new(clock: C, rate_hz: f64) -> io::Result<Self> {
        let timer = clock.timer()?;
        let schedule = Schedule::new(clock.now(), rate_hz);
        Ok(Self { clock, timer, schedule, delivered: 0 })
    }

    /// The schedule of the samples.
    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    /// Waits until at least one more sample is due, and returns how many are. Each sample is returned once.
    /// Cancel-safe.
    ///
    /// # Errors
    /// The system timer fails.
    pub async fn due(&mut self) -> io::Result<u64> {
        loop {
            let count = self.schedule.count(self.clock.now());
            if count > self.delivered {
                return Ok(count - std::mem::replace(&mut self.delivered, count));
            }
            self.timer.until(self.schedule.time(self.delivered)).await?;
        }
    }
}

impl Waiting for SystemClock {
    type Timer = TimerFd;

    fn timer(&self) -> io::Result<TimerFd> {
        TimerFd::new()
    }
}

/// A `timerfd` of the monotonic clock in tokio's reactor.
#[derive(Debug)]
pub struct TimerFd {
    fd: AsyncFd<OwnedFd>,
}

impl TimerFd {
    /// A timer on the current tokio runtime; the timer slack of the calling thread is set to its minimum.
    ///
    /// # Errors
    /// The system refuses the timer slack or the timer.
    #[expect(
        deprecated,
        reason = "the replacement is unsafe because a descriptor may change; an owned one that is not shared cannot"
    )]
    pub fn new() -> io::Result<Self> {
        set_current_timer_slack(NonZeroU64::new(1))?;
        let fd = timerfd_create(TimerfdClockId::Monotonic, TimerfdFlags::NONBLOCK | TimerfdFlags::CLOEXEC)?;
        Ok(Self { fd: AsyncFd::with_interest(fd, Interest::READABLE)? })
    }
}

impl Timer for TimerFd {
    async fn until(&mut self, moment: Mono) -> io::Result<()> {
        // Zero would disarm the timer.
        let ns = moment.0.max(1);
        let it_value = Timespec { tv_sec: ns / NS_PER_S, tv_nsec: ns % NS_PER_S };
        let once = Itimerspec { it_interval: Timespec::default(), it_value };
        timerfd_settime(self.fd.get_ref(), TimerfdTimerFlags::ABSTIME, &once)?;
        loop {
            let mut ready = self.fd.readable().await?;
            let mut expirations = [0; 8];
            match ready.try_io(|fd| Ok(rustix::io::read(fd, &mut expirations)?)) {
                Ok(read) => return read.map(drop),
                // Readiness of an earlier wait that was cancelled.
                Err(_would_block) => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::clock::manual::ManualClock;

    proptest! {
        #[test]
        fn a_sample_is_due_from_its_scheduled_time_on(
            k in 0_u64..1_000_000_000, rate in 1.0_f64..20_000.0, start in 0_i64..i64::MAX / 4,
        ) {
            let schedule = Schedule::new(Mono(start), rate);
            let at = schedule.time(k);
            prop_assert_eq!(schedule.count(at), k + 1);
            prop_assert_eq!(schedule.count(Mono(at.0 - 1)), k);
        }
    }

    #[test]
    fn rounding_errors_do_not_accumulate() {
        let schedule = Schedule::new(Mono(7), 3.0);
        assert_eq!(schedule.time(1), Mono(333_333_340));
        assert_eq!(schedule.time(3_000_000), Mono(1_000_000 * NS_PER_S + 7));
        assert_eq!(schedule.count(Mono(0)), 0);
    }

    #[tokio::test]
    async fn a_late_caller_gets_all_samples() {
        let clock = ManualClock::new();
        let mut pace = Pace::new(clock.clone(), 10_000.0).unwrap();
        assert_eq!(pace.due().await.unwrap(), 1);
        clock.advance(99_999);
        {
            let waiting = pace.due();
            tokio::pin!(waiting);
            assert!(poll_once(waiting.as_mut()).await.is_none());
            clock.advance(1);
            assert_eq!(poll_once(waiting).await.unwrap().unwrap(), 1);
        }
        clock.advance(NS_PER_S);
        assert_eq!(pace.due().await.unwrap(), 10_000);
    }

    /// Polls once.
    async fn poll_once<F: Future>(future: std::pin::Pin<&mut F>) -> Option<F::Output> {
        tokio::select! { biased; out = future => Some(out), () = std::future::ready(()) => None }
    }

    #[tokio::test]
    async fn on_the_real_clock_ten_thousand_samples_a_second_come_due() {
        let mut pace = Pace::new(SystemClock, 10_000.0).unwrap();
        let schedule = *pace.schedule();
        let mut total = 0;
        while total < 10_000 {
            let before = schedule.count(SystemClock.now()).max(total + 1);
            total += pace.due().await.unwrap();
            let after = schedule.count(SystemClock.now());
            assert!((before..=after).contains(&total), "{total} of {before} to {after}");
        }
        assert!(SystemClock.now() >= schedule.time(9_999));
    }

    #[tokio::test]
    async fn a_cancelled_wait_keeps_the_next_due_time() {
        let mut timer = SystemClock.timer().unwrap();
        let start = SystemClock.now();
        let far = start + 3_600 * NS_PER_S;
        tokio::select! { biased; _ = timer.until(far) => panic!("early"), () = tokio::task::yield_now() => {} }
        timer.until(start + 2_000_000).await.unwrap();
        assert!(SystemClock.now() >= start + 2_000_000);
        timer.until(Mono(0)).await.unwrap();
    }
}
