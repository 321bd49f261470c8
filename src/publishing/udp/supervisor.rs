//! Supervises all receivers of datagrams, on the main thread: resolves names, opens sockets, reports which
//! receivers cannot be reached and why, and tries again.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use serde::Serialize;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval, timeout};
use tokio_util::sync::CancellationToken;
use trifacet_core::time::{Clock, Mono, NS_PER_S};
use trifacet_wire::stream::Delivery;

use super::cause::Cause;
use super::health::{Change, Health, Observation};
use super::path::Paths;
use super::receiver::{Kind, Receiver, Way};
use super::resolve::{Resolved, resolve};
use super::sender::Receivers;
use super::socket::{open_target, reconnect};
use crate::clock::SystemClock;
use crate::clock::utc::read_clocks;
use crate::config::{Host, UdpTarget};
use crate::publishing::columns::rfc3339;

/// Interval of the observations.
const LOOK: Duration = Duration::from_millis(500);
/// Interval of the attempts to reach a receiver that fails.
const RETRY_NS: i64 = 3 * NS_PER_S;
/// Longest time for which the start of the daemon waits for names.
const NAMES: Duration = Duration::from_secs(1);

/// The state of a receiver, for status and metrics.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ReceiverState {
    /// The host and port as configured, or the address of a subscriber.
    pub receiver: Arc<str>,
    /// Target or subscriber.
    pub kind: Kind,
    /// The address to which datagrams are sent; `None` while it is unknown.
    pub address: Option<SocketAddr>,
    /// Datagrams sent.
    pub sent: u64,
    /// Datagrams lost: refused by the system, or accepted while the receiver could not be reached.
    pub dropped: u64,
    /// Since when and why datagrams do not reach the receiver; `None` if they do, as far as known.
    pub failing: Option<Failing>,
}

/// A failure that lasts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Failing {
    /// UTC of its beginning, in RFC 3339 format.
    pub since: String,
    /// The present cause.
    pub cause: String,
}

/// Supervises the targets of the configuration and the subscribers.
#[derive(Debug)]
pub struct Supervisor {
    targets: Vec<Target>,
    list: watch::Sender<Arc<[Receiver]>>,
    subscribers: Option<Receivers>,
    subscribed: HashMap<Arc<str>, Watch>,
    lookups: JoinSet<(usize, Result<Resolved, Cause>)>,
    paths: Option<Paths>,
    states: watch::Sender<Arc<[ReceiverState]>>,
}

/// A target of the configuration.
#[derive(Debug)]
struct Target {
    config: UdpTarget,
    receiver: Receiver,
    /// The address of the open socket, or why there is no socket.
    at: Result<Resolved, Cause>,
    /// The name is being resolved.
    pending: bool,
    watch: Watch,
}

/// What is known of a receiver from earlier observations.
#[derive(Debug, Default)]
struct Watch {
    health: Health,
    since: String,
    retry: Mono,
}

impl Supervisor {
    /// Opens the sockets of the targets whose addresses are known without resolving a name. A target that
    /// cannot be opened is a receiver that fails, not an error.
    pub fn new(targets: &[UdpTarget], subscribers: Option<Receivers>) -> Self {
        let paths = Paths::open()
            .inspect_err(|e| tracing::warn!("cannot ask the kernel for routes and neighbours: {e}"))
            .ok();
        let mut supervisor = Self {
            targets: targets.iter().map(Target::new).collect(),
            list: watch::Sender::new([].into()),
            subscribers,
            subscribed: HashMap::new(),
            lookups: JoinSet::new(),
            paths,
            states: watch::Sender::new([].into()),
        };
        for target in supervisor.targets.iter_mut().filter(|target| !target.is_named()) {
            target.found(resolve(&target.config));
        }
        supervisor.publish();
        supervisor
    }

    /// The targets, for [`super::Sender`].
    pub fn targets(&self) -> Receivers {
        self.list.subscribe()
    }

    /// The states of all receivers.
    pub fn states(&self) -> watch::Receiver<Arc<[ReceiverState]>> {
        self.states.subscribe()
    }

    /// Resolves the names, for a second at most: those that take longer follow while the daemon runs.
    pub async fn resolve_names(&mut self) {
        for n in 0..self.targets.len() {
            if self.targets[n].is_named() {
                self.look_up(n);
            }
        }
        let _ = timeout(NAMES, async { while self.looked_up().await {} }).await;
    }

    /// Supervises until `stop`.
    pub async fn run(mut self, stop: CancellationToken) {
        let mut looks = interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                () = stop.cancelled() => return,
                true = self.looked_up() => {}
                _ = looks.tick() => self.look(),
            }
        }
    }

    /// Waits for the next result of a look-up. `false` if none is pending.
    async fn looked_up(&mut self) -> bool {
        let Some(result) = self.lookups.join_next().await else { return false };
        // A look-up cannot panic, and it is cancelled only with the runtime.
        if let Ok((n, found)) = result
            && self.targets[n].found(found)
        {
            self.publish();
        }
        true
    }

    fn publish(&self) {
        self.list.send_replace(self.targets.iter().map(|target| target.receiver.clone()).collect());
    }

    /// Resolves a target again. The thread that does it may wait for a name server.
    fn look_up(&mut self, n: usize) {
        let target = &mut self.targets[n];
        if target.pending {
            return;
        }
        if target.is_named() {
            target.pending = true;
            let config = target.config.clone();
            self.lookups.spawn_blocking(move || (n, resolve(&config)));
        } else if target.found(resolve(&target.config)) {
            self.publish();
        }
    }

    /// Observes all receivers, reports changes, and tries again where it is due.
    fn look(&mut self) {
        let now = SystemClock.now();
        let mut states = self.look_at_targets(now);
        states.extend(self.look_at_subscribers(now));
        self.states.send_replace(states.into());
    }

    fn look_at_targets(&mut self, now: Mono) -> Vec<ReceiverState> {
        let mut due = Vec::new();
        for (n, target) in self.targets.iter_mut().enumerate() {
            let interface = target.at.as_ref().ok().and_then(|at| at.interface);
            let absent = target.at.as_ref().err().cloned();
            let seen = observe(&target.receiver, absent, interface, self.paths.as_mut());
            if target.watch.look(now, &target.receiver, seen) {
                due.push(n);
            }
        }
        for n in due {
            self.look_up(n);
        }
        self.targets.iter().map(|target| target.watch.state(&target.receiver)).collect()
    }

    fn look_at_subscribers(&mut self, now: Mono) -> Vec<ReceiverState> {
        let list = self.subscribers.as_ref().map(|list| Arc::clone(&list.borrow())).unwrap_or_default();
        self.subscribed.retain(|name, _| list.iter().any(|subscriber| subscriber.name == *name));
        let look = |subscriber: &Receiver| {
            let watch = self.subscribed.entry(Arc::clone(&subscriber.name)).or_default();
            let seen = observe(subscriber, None, None, self.paths.as_mut());
            if watch.look(now, subscriber, seen)
                && let Some(way) = &subscriber.way
            {
                // If this fails, so does the next datagram, with the same error.
                let _ = reconnect(&*way.socket, way.to);
            }
            watch.state(subscriber)
        };
        list.iter().map(look).collect()
    }
}

/// The name that has to be resolved to reach a target, if there is one.
fn name_of(target: &UdpTarget) -> Option<&str> {
    match &target.address.host {
        Host::Name(name) => Some(name),
        Host::Address(_) | Host::Zoned(..) => None,
    }
}

fn observe(
    receiver: &Receiver,
    absent: Option<Cause>,
    interface: Option<u32>,
    paths: Option<&mut Paths>,
) -> Observation {
    let to = receiver.way.as_ref().map(|way| way.to);
    let obstacle = to.zip(paths).and_then(|(to, paths)| paths.obstacle(to, interface));
    let tally = &receiver.tally;
    Observation {
        absent,
        obstacle,
        sent: tally.sent.get(),
        refused: tally.refused.get(),
        errno: tally.errno(),
    }
}

impl Target {
    fn new(config: &UdpTarget) -> Self {
        let UdpTarget { address, divider, big_endian, held, .. } = config;
        let delivery = Delivery { divider: *divider, big_endian: *big_endian, held: *held };
        let name = address.to_string().into();
        let receiver = Receiver { name, kind: Kind::Target, delivery, way: None, tally: Arc::default() };
        let at = Err(Cause::Pending(name_of(config).unwrap_or_default().to_owned()));
        Self { config: config.clone(), receiver, at, pending: false, watch: Watch::default() }
    }

    /// Whether resolving the target may take time.
    fn is_named(&self) -> bool {
        name_of(&self.config).is_some()
    }

    /// Takes the result of a look-up. Returns whether the receiver has changed.
    fn found(&mut self, found: Result<Resolved, Cause>) -> bool {
        self.pending = false;
        let open = self.receiver.way.is_some();
        let found = match found {
            // The socket of a group is replaced in any case: its interface may be another one by now.
            Ok(found) if open && self.at.as_ref() == Ok(&found) && !found.to.ip().is_multicast() => {
                return false;
            }
            // An earlier address of the name may be right: the name server may be what fails.
            Err(Cause::Name { .. }) if open => return false,
            found => found,
        };
        let opened = found.and_then(|at| {
            let socket = open_target(&self.config, at)
                .map_err(|e| Cause::Socket(e.raw_os_error().unwrap_or_default()))?;
            Ok((at, Way { socket: Arc::new(socket), to: at.to }))
        });
        (self.at, self.receiver.way) = match opened {
            Ok((at, way)) => (Ok(at), Some(way)),
            Err(cause) => (Err(cause), None),
        };
        true
    }
}

impl Watch {
    /// Takes an observation and logs a change. Returns whether another attempt to reach the receiver is due.
    fn look(&mut self, now: Mono, receiver: &Receiver, seen: Observation) -> bool {
        // Copies of a group's datagrams may reach this machine even if they cannot leave it.
        let group = receiver.way.as_ref().is_some_and(|way| way.to.ip().is_multicast());
        let obstructed = seen.obstacle.is_some();
        let change = self.health.observe(now, seen);
        receiver.tally.set_unreachable(obstructed && !group && self.health.failing().is_some());
        let name = &receiver.name;
        match (change, self.health.failing()) {
            (Some(Change::Fails), Some(cause)) => {
                (self.since, self.retry) = (rfc3339(read_clocks().1), now);
                tracing::warn!(receiver = %name, "cannot send datagrams (counted in udp_dropped): {cause}");
            }
            (Some(Change::Works), _) => {
                let dropped = receiver.tally.dropped.get();
                tracing::info!(receiver = %name, dropped, "sending datagrams again");
            }
            _ => {}
        }
        let due = self.health.failing().is_some() && now - self.retry >= RETRY_NS;
        if due {
            self.retry = now;
        }
        due
    }

    fn state(&self, receiver: &Receiver) -> ReceiverState {
        let failing = self.health.failing();
        ReceiverState {
            receiver: Arc::clone(&receiver.name),
            kind: receiver.kind,
            address: receiver.way.as_ref().map(|way| way.to),
            sent: receiver.tally.sent.get(),
            dropped: receiver.tally.dropped.get(),
            failing: failing.map(|cause| Failing { since: self.since.clone(), cause: cause.to_string() }),
        }
    }
}
