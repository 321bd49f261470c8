//! Judges from counts whether datagrams reach a receiver. Pure.

use trifacet_core::time::{Mono, NS_PER_S};

use super::cause::Cause;

/// Time without a failure after which a receiver works again. Longer than the three seconds in which the kernel
/// tries to resolve an address and accepts datagrams meanwhile.
const QUIET_NS: i64 = 5 * NS_PER_S;

/// The present state of a receiver.
#[derive(Clone, Debug, Default)]
pub struct Observation {
    /// Why there is no socket; `None` while a socket is open.
    pub absent: Option<Cause>,
    /// What prevents accepted datagrams from leaving.
    pub obstacle: Option<Cause>,
    /// Datagrams accepted so far.
    pub sent: u64,
    /// Datagrams refused so far.
    pub refused: u64,
    /// Error number of the last refusal.
    pub errno: i32,
}

/// A change to log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Datagrams are lost from now on.
    Fails,
    /// The receiver works again.
    Works,
}

/// The history of a receiver, as far as it matters.
#[derive(Debug, Default)]
pub struct Health {
    failing: Option<Cause>,
    /// The last observation contained an obstacle.
    obstructed: bool,
    refused: u64,
    last_failure: Mono,
    sent_before: u64,
}

impl Health {
    /// Why datagrams do not reach the receiver; `None` if they do, as far as known.
    pub fn failing(&self) -> Option<&Cause> {
        self.failing.as_ref()
    }

    /// Takes an observation. The cause of a failure may change without a [`Change`].
    pub fn observe(&mut self, now: Mono, seen: Observation) -> Option<Change> {
        let refused = seen.refused > self.refused;
        // One observation is not enough: a host that has not been used for some time answers within milliseconds.
        let persists = self.obstructed || self.failing.is_some();
        (self.refused, self.obstructed) = (seen.refused, seen.obstacle.is_some());
        let of_send = || refused.then(|| Cause::of_send(seen.errno));
        let cause = seen.absent.or_else(|| seen.obstacle.filter(|_| persists || refused)).or_else(of_send);
        if let Some(cause) = cause {
            (self.last_failure, self.sent_before) = (now, seen.sent);
            return self.failing.replace(cause).is_none().then_some(Change::Fails);
        }
        let quiet = now - self.last_failure >= QUIET_NS && seen.sent > self.sent_before;
        (quiet && self.failing.take().is_some()).then_some(Change::Works)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half seconds.
    fn at(half_s: i64) -> Mono {
        Mono(half_s * NS_PER_S / 2)
    }

    fn counts(sent: u64, refused: u64) -> Observation {
        Observation { sent, refused, errno: 101, ..Observation::default() }
    }

    fn obstructed(sent: u64, refused: u64) -> Observation {
        let obstacle = Some(Cause::NoLink { interface: "eth0".into() });
        Observation { obstacle, errno: 11, ..counts(sent, refused) }
    }

    #[test]
    fn a_failure_is_reported_once_and_its_end_once() {
        let mut health = Health::default();
        assert_eq!(health.observe(at(0), counts(10, 0)), None);
        assert_eq!(health.observe(at(1), counts(10, 5)), Some(Change::Fails));
        assert_eq!(health.failing(), Some(&Cause::Refused(101)));
        // For hours, some datagrams are accepted, and every three seconds one is refused.
        let counts_at = |t: i64| counts(10 + t as u64, 5 + t as u64 / 6);
        assert!((2..10_000).all(|t| health.observe(at(t), counts_at(t)).is_none()));
        // The last refusal was at 9996.
        let changes: Vec<_> = (10_000..20_000)
            .filter_map(|t| Some((t, health.observe(at(t), Observation { refused: 1671, ..counts_at(t) })?)))
            .collect();
        assert_eq!(changes, [(10_006, Change::Works)]);
        assert_eq!(health.failing(), None);
    }

    #[test]
    fn silence_is_no_proof_that_a_receiver_works() {
        let mut health = Health::default();
        assert_eq!(health.observe(at(0), counts(7, 1)), Some(Change::Fails));
        assert_eq!(health.observe(at(1000), counts(7, 1)), None, "nothing was sent");
        assert_eq!(health.observe(at(1001), counts(8, 1)), Some(Change::Works));
    }

    #[test]
    fn a_short_obstacle_without_loss_is_ignored_and_a_persistent_one_is_a_failure() {
        let mut health = Health::default();
        assert_eq!(health.observe(at(0), obstructed(1, 0)), None);
        assert_eq!(health.observe(at(1), counts(9, 0)), None);
        assert_eq!(health.observe(at(2), obstructed(10, 0)), None);
        assert_eq!(health.observe(at(3), obstructed(10, 0)), Some(Change::Fails));
        assert_eq!(health.observe(at(4), counts(10, 0)), None);
        assert_eq!(health.observe(at(5), obstructed(10, 0)), None);
        assert_eq!(health.observe(at(14), counts(99, 0)), None, "less than five seconds");
        assert_eq!(health.observe(at(15), counts(99, 0)), Some(Change::Works));
    }

    #[test]
    fn an_obstacle_explains_a_refusal_and_the_newest_cause_is_kept() {
        let mut health = Health::default();
        assert_eq!(health.observe(at(0), obstructed(0, 1)), Some(Change::Fails));
        assert!(matches!(health.failing(), Some(Cause::NoLink { .. })));
        assert_eq!(health.observe(at(1), counts(0, 2)), None);
        assert_eq!(health.failing(), Some(&Cause::Refused(101)));
        let absent = Observation { absent: Some(Cause::Interface("eth7".into())), ..counts(0, 2) };
        assert_eq!(health.observe(at(2), absent), None);
        assert_eq!(health.failing(), Some(&Cause::Interface("eth7".into())));
    }
}
