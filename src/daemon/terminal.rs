//! The terminal from which a daemon was started by hand.
//!
//! SIGHUP has two meanings: a request to read the configuration again, and the loss of the controlling terminal,
//! which the kernel or the shell reports. Only the state of the terminal distinguishes them: after its loss,
//! `/dev/tty` cannot be opened any more. The loss can precede the signal, since a shell passes it on, or follow it.

use rustix::fs::{Mode, OFlags, open};
use trifacet_core::time::{Mono, NS_PER_S};

/// Longest time between SIGHUP and the loss of the terminal if one belongs to the other, nanoseconds.
const TOGETHER_NS: i64 = 5 * NS_PER_S;
/// SIGHUP in a mask of signals of the kernel.
const HANGUP_BIT: u64 = 1;

/// Observes the controlling terminal.
#[derive(Debug)]
pub(super) struct Terminal {
    /// The daemon ends with its terminal.
    attended: bool,
    /// Time of the last check that found the terminal.
    there: Mono,
    /// Time of the first check that did not.
    lost: Option<Mono>,
    /// Time of the last SIGHUP.
    hangup: Option<Mono>,
}

impl Terminal {
    /// The terminal of this process. Must be called before SIGHUP gets a handler: whoever starts the daemon
    /// with SIGHUP ignored (`nohup`) wants it to go on without the terminal.
    pub(super) fn of_process(now: Mono) -> Self {
        Self { attended: exists() && !hangup_is_ignored(), there: now, lost: None, hangup: None }
    }

    /// Whether the daemon ends with its terminal.
    pub(super) fn attended(&self) -> bool {
        self.attended
    }

    /// Registers a SIGHUP. Returns whether it reports the loss of the terminal.
    pub(super) fn hangup(&mut self, now: Mono) -> bool {
        self.hangup = Some(now);
        self.is_closed(now)
    }

    /// Checks the terminal. Returns whether it was lost together with a SIGHUP.
    pub(super) fn is_closed(&mut self, now: Mono) -> bool {
        self.attended && self.check(now, exists())
    }

    fn check(&mut self, now: Mono, exists: bool) -> bool {
        let lost = match self.lost {
            Some(lost) => lost,
            None if exists => {
                self.there = now;
                return false;
            }
            None => *self.lost.insert(now),
        };
        let together = |hangup: Mono| self.there - hangup <= TOGETHER_NS && hangup - lost <= TOGETHER_NS;
        if self.hangup.is_some_and(together) {
            return true;
        }
        if now - lost > TOGETHER_NS {
            self.attended = false;
            tracing::warn!("the terminal was closed without SIGHUP: the daemon goes on; SIGTERM ends it");
        }
        false
    }
}

/// Whether this process has a controlling terminal.
fn exists() -> bool {
    let flags = OFlags::RDONLY | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    open("/dev/tty", flags, Mode::empty()).is_ok()
}

fn hangup_is_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask & HANGUP_BIT != 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = NS_PER_S;

    fn open_terminal() -> Terminal {
        Terminal { attended: true, there: Mono(0), lost: None, hangup: None }
    }

    #[test]
    fn a_loss_and_a_hangup_belong_together_in_any_order() {
        for (hangup, checks) in [
            (10, &[(10, true), (11, false)][..]), // the terminal goes shortly after the signal
            (10, &[(9, true), (10, false)]),
            (12, &[(9, true), (10, false), (12, false)]), // a shell passed the signal on
            (10, &[(10, true), (40, false)]),             // the daemon was busy in between
        ] {
            let mut terminal = open_terminal();
            let closed: Vec<_> = checks
                .iter()
                .map(|(at, exists)| {
                    if *at >= hangup {
                        terminal.hangup.get_or_insert(Mono(hangup * S));
                    }
                    terminal.check(Mono(at * S), *exists)
                })
                .collect();
            let (last, before) = closed.split_last().unwrap();
            assert!(*last && before.iter().all(|closed| !closed), "{checks:?}: {closed:?}");
        }
    }

    #[test]
    fn a_reload_and_a_loss_without_a_hangup_do_not_end_the_daemon() {
        let mut terminal = open_terminal();
        terminal.hangup = Some(Mono(10 * S)); // a reload, long before the loss
        assert!(!terminal.check(Mono(10 * S), true) && !terminal.check(Mono(20 * S), true));
        assert!(!terminal.check(Mono(21 * S), false) && terminal.attended);
        assert!(!terminal.check(Mono(27 * S), false) && !terminal.attended);
        terminal.hangup = Some(Mono(100 * S)); // a reload after it
        assert!(!terminal.is_closed(Mono(100 * S)));
    }
}
