//! Leased subscriptions to datagrams, without a socket: datagrams and times in, answers and the list of subscribers
//! out.
//!
//! The source address of a datagram can be forged. Therefore the daemon stores nothing about an address and
//! sends no frames to it until the address has proved that it receives: the client must repeat a nonce, which
//! is a keyed hash of its address. Before this proof an answer is at most twice as long as the request, so
//! that an attacker gains nothing by directing answers at a third party.

use std::hash::{BuildHasher, RandomState};
use std::net::SocketAddr;
use std::sync::Arc;

use tokio::sync::watch;
use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_wire::stream::{Delivery, Descriptor, SubscriptionRequest};

use crate::config::Network;

/// Period of a nonce in seconds. A nonce is valid for between one and two periods.
const NONCE_S: i64 = 60;

/// A receiver that has subscribed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Subscriber {
    /// The address to which datagrams are sent.
    pub address: SocketAddr,
    /// Divider, byte order and held pose.
    pub delivery: Delivery,
}

/// The result of a datagram.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[must_use]
pub struct Outcome {
    /// Answer to send back.
    pub answer: Option<String>,
    /// The list of subscribers has changed.
    pub changed: bool,
    /// The request was refused.
    pub refused: bool,
}

/// The subscribers and the ends of their leases.
#[derive(Debug)]
pub struct Subscriptions {
    /// Random, drawn when the daemon starts.
    key: RandomState,
    /// States the present session.
    descriptor: watch::Receiver<Descriptor>,
    most: usize,
    allow: Vec<Network>,
    leases: Vec<Lease>,
}

#[derive(Clone, Copy, Debug)]
struct Lease {
    to: Subscriber,
    nonce: u64,
    ends: Mono,
}

impl Subscriptions {
    /// An empty list for at most `most` subscribers from the networks in `allow`.
    pub fn new(descriptor: watch::Receiver<Descriptor>, most: usize, allow: Vec<Network>) -> Self {
        Self { key: RandomState::new(), descriptor, most, allow, leases: Vec::new() }
    }

    /// The current subscribers.
    pub fn subscribers(&self) -> Arc<[Subscriber]> {
        self.leases.iter().map(|lease| lease.to).collect()
    }

    /// The end of the lease that ends first.
    pub fn next_end(&self) -> Option<Mono> {
        self.leases.iter().map(|lease| lease.ends).min()
    }

    /// Removes expired leases. Returns whether there was one.
    pub fn expire(&mut self, now: Mono) -> bool {
        let before = self.leases.len();
        self.leases.retain(|lease| lease.ends > now);
        self.leases.len() < before
    }

    /// Handles a datagram.
    pub fn datagram(&mut self, from: SocketAddr, bytes: &[u8], now: Mono) -> Outcome {
        let Some(ask) = SubscriptionRequest::parse(bytes) else {
            return Outcome { refused: true, ..Outcome::default() };
        };
        let allowed = self.allow.iter().any(|network| network.contains(from.ip()));
        let mut outcome = match ask {
            _ if !allowed => refusal("address not in [publishing] allow"),
            Err(why) => refusal(&why.to_string()),
            Ok(ask) => {
                let (SubscriptionRequest::Subscribe { nonce: Some(said), .. }
                | SubscriptionRequest::Unsubscribe { nonce: said }) = ask
                else {
                    return self.challenge(from, bytes, now);
                };
                if !self.genuine(from, said, now) {
                    return self.challenge(from, bytes, now);
                }
                return self.grant(from, ask, said, now);
            }
        };
        // The address has not proved that it receives: at most twice the length of the request.
        if let Some(answer) = &mut outcome.answer {
            answer.truncate(2 * bytes.len());
        }
        outcome
    }

    /// Asks the client to repeat the request with the nonce. No answer if that would be too long.
    fn challenge(&self, from: SocketAddr, bytes: &[u8], now: Mono) -> Outcome {
        let answer = format!("challenge nonce={:016x}", self.nonce(from, now));
        Outcome { answer: (answer.len() <= 2 * bytes.len()).then_some(answer), ..Outcome::default() }
    }

    fn grant(&mut self, from: SocketAddr, ask: SubscriptionRequest, nonce: u64, now: Mono) -> Outcome {
        let own = self.leases.iter().position(|lease| lease.to.address == from);
        let SubscriptionRequest::Subscribe { lease_s, delivery, .. } = ask else {
            own.map(|own| self.leases.swap_remove(own));
            return granted("ok unsubscribed".into(), own.is_some());
        };
        let ends = now + i64::from(lease_s) * NS_PER_S;
        let lease = Lease { to: Subscriber { address: from, delivery }, nonce, ends };
        let changed = match own {
            Some(own) => std::mem::replace(&mut self.leases[own], lease).to != lease.to,
            None if self.leases.len() >= self.most => {
                return refusal(&format!("the daemon already has {} subscribers, the maximum", self.most));
            }
            None => {
                self.leases.push(lease);
                true
            }
        };
        let Delivery { divider, .. } = delivery;
        let session = self.descriptor.borrow().session;
        granted(format!("ok lease_s={lease_s} divider={divider} session={session:08x}"), changed)
    }

    /// Ends a subscription that has just been granted and cannot be served, for this reason.
    pub fn revoke(&mut self, address: SocketAddr, why: &str) -> Outcome {
        self.leases.retain(|lease| lease.to.address != address);
        refusal(why)
    }

    /// Whether this nonce was sent to this address recently, or belongs to its subscription.
    fn genuine(&self, from: SocketAddr, said: u64, now: Mono) -> bool {
        let earlier = now + -NONCE_S * NS_PER_S;
        let of_lease = || self.leases.iter().any(|l| l.to.address == from && l.nonce == said);
        said == self.nonce(from, now) || said == self.nonce(from, earlier) || of_lease()
    }

    /// SipHash with a random key: only a receiver at this address can know the value.
    fn nonce(&self, of: SocketAddr, now: Mono) -> u64 {
        self.key.hash_one((of, now.0.div_euclid(NONCE_S * NS_PER_S)))
    }
}

fn granted(answer: String, changed: bool) -> Outcome {
    Outcome { answer: Some(answer), changed, refused: false }
}

fn refusal(why: &str) -> Outcome {
    Outcome { answer: Some(format!("error: {why}")), changed: false, refused: true }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::publishing::StreamId;
    use crate::publishing::descriptor::StreamFacts;

    const S: i64 = NS_PER_S;

    fn some() -> Subscriptions {
        let id = StreamId { session: 0xab, config: 0 };
        let (_, descriptor) = watch::channel(StreamFacts::example(id).descriptor());
        Subscriptions::new(descriptor, 2, Network::loopback())
    }

    fn client(port: u16) -> SocketAddr {
        ([127, 0, 0, 1], port).into()
    }

    /// Subscribes: sends the request, then repeats it with the nonce.
    fn subscribe(all: &mut Subscriptions, from: SocketAddr, ask: &str, now: Mono) -> (String, Outcome) {
        let challenge = all.datagram(from, ask.as_bytes(), now).answer.unwrap();
        let nonce = challenge.strip_prefix("challenge ").unwrap().to_owned();
        let outcome = all.datagram(from, format!("{ask} {nonce}\n").as_bytes(), now);
        (nonce, outcome)
    }

    #[test]
    fn a_subscription_needs_the_challenge_can_be_renewed_and_expires() {
        let mut all = some();
        let ask = "subscribe lease_s=10 divider=4 held=on";
        let (nonce, outcome) = subscribe(&mut all, client(1), ask, Mono(0));
        assert_eq!(outcome, granted("ok lease_s=10 divider=4 session=000000ab".into(), true));
        let delivery = Delivery { divider: 4, big_endian: false, held: true };
        assert_eq!(&*all.subscribers(), [Subscriber { address: client(1), delivery }]);
        assert_eq!(all.next_end(), Some(Mono(10 * S)));
        // A subscription lasts as long as it is renewed, whatever the age of its nonce.
        for t in (9..900).step_by(9) {
            assert!(!all.expire(Mono(t * S)));
            let renewed = all.datagram(client(1), format!("{ask} {nonce}").as_bytes(), Mono(t * S));
            assert!(renewed.answer.unwrap().starts_with("ok ") && !renewed.changed);
        }
        assert!(all.expire(Mono(1000 * S)) && all.subscribers().is_empty());
        let late = all.datagram(client(1), format!("{ask} {nonce}").as_bytes(), Mono(1000 * S));
        assert!(late.answer.unwrap().starts_with("challenge ") && !late.changed);
    }

    #[test]
    fn a_nonce_of_another_address_or_a_guess_is_challenged() {
        let mut all = some();
        let (nonce, _) = subscribe(&mut all, client(1), "subscribe lease_s=10", Mono(0));
        for (from, nonce) in [(client(2), nonce.as_str()), (client(1), "nonce=0"), (client(2), "nonce=ff")] {
            let ask = format!("subscribe lease_s=60 divider=9 {nonce}");
            let outcome = all.datagram(from, ask.as_bytes(), Mono(0));
            assert!(outcome.answer.unwrap().starts_with("challenge "));
            let stop = all.datagram(client(2), format!("unsubscribe {nonce}").as_bytes(), Mono(0));
            assert!(!outcome.changed && !stop.changed);
        }
        assert_eq!(all.subscribers()[0].delivery.divider, 1);
        let stop = all.datagram(client(1), format!("unsubscribe {nonce}").as_bytes(), Mono(0));
        assert_eq!(stop, granted("ok unsubscribed".into(), true));
    }

    #[test]
    fn the_number_of_places_is_limited_and_only_allowed_networks_get_one() {
        let mut all = some();
        for port in [1, 2] {
            assert!(subscribe(&mut all, client(port), "subscribe lease_s=1", Mono(0)).1.changed);
        }
        let (_, third) = subscribe(&mut all, client(3), "subscribe lease_s=1", Mono(0));
        assert!(third.refused && third.answer.unwrap().contains("2 subscribers"));
        let stranger = SocketAddr::from(([10, 0, 0, 1], 1));
        let outcome = all.datagram(stranger, b"subscribe lease_s=10", Mono(0));
        assert!(outcome.refused && outcome.answer.unwrap().contains("[publishing] allow"));
    }

    #[test]
    fn errors_get_a_short_answer_and_foreign_datagrams_none() {
        let mut all = some();
        for (ask, expected) in [
            ("subscribe lease_s=0 divider=1", "lease_s=0; allowed: 1 to 60"),
            ("subscribe lease_s=61", "lease_s=61; allowed: 1 to 60"),
            ("subscribe divider=1 held=on", "no lease_s; allowed: lease_s=1 to 60"),
            ("subscribe lease_s=5 divider=0 held=on", "divider=0; allowed: a divider from 1"),
            ("subscribe lease_s=5 held=yes", "held=yes; allowed: on, off"),
            ("subscribe lease_s=5 nonce=xyz", "nonce=xyz; allowed: nonce=HEX"),
            ("subscribe lease_s=5 rate_hz=5 held=on", "rate_hz=5; allowed: lease_s= divider="),
            ("unsubscribe me please", "me; allowed: unsubscribe nonce=HEX"),
        ] {
            let answer = all.datagram(client(1), ask.as_bytes(), Mono(0)).answer.unwrap();
            assert!(answer.starts_with("error: ") && answer.contains(expected), "{ask}: {answer}");
        }
        for other in ["error: x", "challenge nonce=1", "ok", "", "SUBSCRIBE lease_s=1", "\u{e9}"] {
            assert_eq!(all.datagram(client(1), other.as_bytes(), Mono(0)).answer, None, "{other}");
        }
    }

    proptest! {
        /// Without the nonce, no request changes the list or gets an answer of more than twice its length.
        #[test]
        fn an_answer_is_at_most_twice_as_long_as_the_request(
            bytes in prop_oneof![
                prop::collection::vec(any::<u8>(), 0..200),
                "(un)?subscribe( (lease_s|divider|held|nonce|big_endian|x)=[0-9a-fon]{0,17}){0,6}".prop_map(String::into_bytes),
            ],
        ) {
            let mut all = some();
            let outcome = all.datagram(client(1), &bytes, Mono(0));
            prop_assert!(outcome.answer.is_none_or(|a| a.len() <= 2 * bytes.len() && a.is_ascii()));
            prop_assert!(!outcome.changed);
        }
    }
}
