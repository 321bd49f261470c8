//! Receivers of datagrams that vanish, come back, and change their addresses.

use std::fs;

use serde_json::Value;

use crate::testkit::{Daemon, Network, Receiver, run, trifacet, wait_for};

/// Frames per second: low enough for a receiver that waits for a CPU, high enough to fill a send buffer within
/// the three seconds in which the kernel looks for a host.
const RATE: u64 = 200;
/// More frames than can wait in the buffers of a socket: 208 KiB, in which each takes 768 bytes or more.
const AWAITED: u64 = 300;
const FAILS: &str = "cannot send datagrams";
const WORKS: &str = "sending datagrams again";

fn config(publishing: &str) -> String {
    format!("acquisition.rate_hz = {RATE}\n[publishing]\ntcp = '127.0.0.1:0'\n{publishing}\n")
}

/// The state of a receiver in the status.
fn state(daemon: &Daemon, name: &str) -> Value {
    let status = daemon.status();
    let all = status["receivers"].as_array().unwrap();
    let found = all.iter().find(|receiver| receiver["receiver"].as_str().unwrap().starts_with(name));
    found.cloned().unwrap_or_default()
}

/// Waits until a receiver fails; returns the cause.
fn fails(daemon: &Daemon, name: &str) -> String {
    wait_for("failing", || {
        let state = state(daemon, name);
        state["failing"]["cause"].as_str().map(str::to_owned).ok_or_else(|| state.to_string())
    })
}

/// Waits until a receiver works, and datagrams are sent to it.
fn works(daemon: &Daemon, name: &str) {
    let before = state(daemon, name)["sent"].as_u64().unwrap();
    wait_for("working", || {
        let state = state(daemon, name);
        let sent = state["sent"].as_u64().is_some_and(|sent| sent > before);
        if sent && state["failing"].is_null() { Ok(()) } else { Err(state.to_string()) }
    });
}

/// The number of log lines so far with this message about a receiver.
fn lines(daemon: &mut Daemon, message: &str, name: &str) -> usize {
    daemon.read_log();
    let about = |line: &&Value| {
        line["message"].as_str().is_some_and(|text| text.contains(message)) && line["receiver"] == name
    };
    daemon.log.iter().filter(about).count()
}

#[test]
fn a_subscriber_that_vanishes_costs_no_other_one_a_frame() {
    let Some(network) = Network::open() else { return };
    network.cable("w0", "w1");
    network.near("ip addr add 10.8.0.1/24 dev w0");
    network.far("ip addr add 10.7.0.2/24 dev v1; ip addr add 10.8.0.2/24 dev w1");
    let mut daemon = network.daemon(&config("udp = []\nsubscribe = '0.0.0.0:7363'\nallow = ['10.0.0.0/8']"));
    daemon.subscriptions();
    let mut victim = network.watch("subscribe://10.8.0.1:7363");
    let mut other = network.watch("subscribe://10.7.0.1:7363");
    victim.sequence();
    let mut last = other.sequence();
    network.far("ip addr del 10.8.0.2/24 dev w1");
    network.near("ip neigh flush dev w0");
    let before = last;
    loop {
        let sequence = other.sequence();
        assert_eq!(sequence, last + 1, "a frame is missing");
        last = sequence;
        // Until the send buffer of the other one has been full for a second.
        let victim = state(&daemon, "10.8.0.2");
        if victim["dropped"].as_u64().is_some_and(|dropped| dropped > RATE) {
            let cause = victim["failing"]["cause"].as_str().unwrap_or_default();
            assert!(cause.contains("10.8.0.2 does not answer on w0"), "{victim}");
            break;
        }
        assert!(last - before < 60 * RATE, "{victim}");
    }
    let state = state(&daemon, "10.7.0.2");
    assert_eq!(
        (&state["dropped"], &state["failing"], &state["kind"]),
        (&0.into(), &Value::Null, &"subscriber".into())
    );
}

#[test]
fn a_dead_target_costs_a_line_when_it_fails_and_one_when_it_works_again() {
    let Some(network) = Network::open() else { return };
    let target = "10.7.0.2:7362";
    let mut daemon = network.daemon(&config(&format!(
        "udp = ['{target}', '127.0.0.1:7362']\n[monitor]\nlisten = '127.0.0.1:7360'"
    )));
    // Several attempts of the kernel to find the host, three seconds each.
    wait_for("dropped", || {
        let dropped = state(&daemon, target)["dropped"].as_u64().unwrap_or_default();
        if dropped > 10 * RATE { Ok(()) } else { Err(dropped.to_string()) }
    });
    let cause = fails(&daemon, target);
    assert!(cause.contains("the host 10.7.0.2 does not answer on v0"), "{cause}");
    let counted = daemon.status()["counters"]["udp_dropped"].as_u64().unwrap();
    assert!(counted > 10 * RATE, "{counted}");
    let file = daemon.file();
    let doctor = run(&mut network.trifacet(&[
        "doctor",
        "--config",
        file.to_str().unwrap(),
        &format!("tcp://{}", daemon.address()),
    ]));
    assert_eq!(doctor.code, 0, "{} {}", doctor.out, doctor.err);
    assert!(
        doctor.out.contains(&format!("no datagrams reach the target {target} since 20")),
        "{}",
        doctor.out
    );
    let socket = daemon.socket();
    let status = run(&mut network.trifacet(&[
        "status",
        &format!("tcp://{}", daemon.address()),
        "--socket",
        socket.to_str().unwrap(),
    ]));
    assert!(status.out.contains(&format!("receiver  {target} fails since 20")), "{}", status.out);

    network.far("ip addr add 10.7.0.2/24 dev v1");
    let mut receiver = network.watch(&format!("udp://{target}"));
    let first = receiver.sequence();
    assert!(receiver.sequence() > first);
    works(&daemon, target);
    let line = daemon.message(WORKS);
    assert!(line["dropped"].as_u64().unwrap() > 10 * RATE, "{line}");
    assert_eq!(
        (lines(&mut daemon, FAILS, target), lines(&mut daemon, WORKS, target)),
        (1, 1),
        "{:#?}",
        daemon.log
    );
    assert_eq!(lines(&mut daemon, FAILS, "127.0.0.1:7362"), 0, "nobody listens there: not a failure");
}

/// A network whose daemon has three targets and a subscriber, all at v1.
struct Lab {
    network: Network,
    daemon: Daemon,
    subscriber: Receiver,
}

impl Lab {
    const TARGETS: [&str; 3] = ["10.7.0.2:7362", "[fe80::7%v0]:7362", "239.255.0.1:7362"];
    /// The addresses of the receivers.
    const ADDRESSES: &str = "ip addr replace 10.7.0.2/24 dev v1; ip addr replace fe80::7/64 dev v1 nodad";

    fn open() -> Option<Self> {
        let network = Network::open()?;
        network.far(Self::ADDRESSES);
        let mut daemon = network.daemon(&config(
            "udp = ['10.7.0.2:7362', '[fe80::7%v0]:7362', { address = '239.255.0.1:7362', interface = 'v0' }]\n\
             subscribe = '10.7.0.1:7363'\nallow = ['10.0.0.0/8']",
        ));
        daemon.subscriptions();
        let subscriber = network.watch("subscribe://10.7.0.1:7363");
        let mut lab = Self { network, daemon, subscriber };
        lab.all_work();
        Some(lab)
    }

    fn all_work(&mut self) {
        for target in Self::TARGETS {
            works(&self.daemon, target);
        }
        self.subscriber.goes_on(AWAITED);
    }

    /// Disturbs the network until this target fails for this cause, and then restores it.
    fn recovers(&mut self, disturb: &str, target: &str, cause: &str, restore: impl Fn(&Network)) {
        self.network.near(disturb);
        let told = fails(&self.daemon, target);
        assert!(told.contains(cause), "{disturb}: {told}");
        restore(&self.network);
        self.all_work();
    }
}

#[test]
fn all_receivers_work_again_after_changes_of_interfaces_addresses_and_cables() {
    let Some(mut lab) = Lab::open() else { return };
    let [host, _, group] = Lab::TARGETS;
    lab.recovers("ip link set v0 down", host, "Network is unreachable", |network| {
        network.near("ip link set v0 up");
    });
    lab.recovers("ip addr del 10.7.0.1/24 dev v0", host, "Network is unreachable", |network| {
        network.near("ip addr add 10.7.0.1/24 dev v0");
    });
    lab.network.far("ip link set v1 down");
    lab.recovers("true", group, "v0 has no link", |network| {
        network.far("ip link set v1 up");
        network.far(Lab::ADDRESSES);
    });
    // The new interface of the same name has another number.
    lab.recovers("ip link del v0", group, "", |network| {
        network.cable("v0", "v1");
        network.near("ip addr add 10.7.0.1/24 dev v0");
        network.far(Lab::ADDRESSES);
    });
}

#[test]
fn targets_that_do_not_exist_at_the_start_are_reached_as_soon_as_they_do() {
    let Some(network) = Network::open() else { return };
    let mut daemon = network.daemon(&config(
        "udp = ['plc.test:7362', '10.99.0.2:7362', '[fe80::9%w0]:7362', { address = '239.255.0.1:7362', interface = 'w0' }]",
    ));
    for (name, cause) in [
        ("plc.test:7362", "the name plc.test cannot be resolved"),
        ("10.99.0.2:7362", "Network is unreachable"),
        ("[fe80::9%w0]:7362", "there is no interface w0"),
        ("239.255.0.1:7362", "there is no interface w0"),
    ] {
        let told = fails(&daemon, name);
        assert!(told.contains(cause), "{name}: {told}");
    }
    network.cable("w0", "w1");
    network.near("ip addr add 10.99.0.1/24 dev w0");
    network.far("ip addr add 10.99.0.2/24 dev w1; ip -6 addr add fe80::9/64 dev w1 nodad; ip addr add 10.7.0.2/24 dev v1");
    fs::write(network.hosts(), "127.0.0.1 localhost\n10.7.0.2 plc.test\n").unwrap();
    for name in ["plc.test:7362", "10.99.0.2:7362", "[fe80::9%w0]:7362", "239.255.0.1:7362"] {
        works(&daemon, name);
    }
    assert_eq!(state(&daemon, "plc.test")["address"], "10.7.0.2:7362");
    // The host moves to another address.
    network.far("ip addr del 10.7.0.2/24 dev v1; ip addr add 10.7.0.3/24 dev v1");
    network.near("ip neigh flush dev v0");
    fs::write(network.hosts(), "127.0.0.1 localhost\n10.7.0.3 plc.test\n").unwrap();
    let mut receiver = network.watch("udp://10.7.0.3:7362");
    receiver.sequence();
    works(&daemon, "plc.test:7362");
    assert_eq!(lines(&mut daemon, FAILS, "plc.test:7362"), 2, "{:#?}", daemon.log);
}

#[test]
fn check_tells_what_names_resolve_to() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lab.toml");
    fs::write(
        &file,
        "[publishing]\nudp = ['localhost:7362', 'no-such-host.invalid:7362', '[fe80::1%no-such-if]:7362']\n",
    )
    .unwrap();
    let done = run(trifacet(&["check", "--config"]).arg(&file));
    assert_eq!(done.code, 0, "{}", done.err);
    let local = ["localhost:7362 (127.0.0.1)", "localhost:7362 (::1)"];
    assert!(local.iter().any(|text| done.out.contains(text)), "{}", done.out);
    for told in ["name no-such-host.invalid cannot be resolved", "there is no interface no-such-if"] {
        assert!(done.out.contains(told), "{told}: {}", done.out);
    }
}

#[test]
fn listeners_are_reached_whenever_an_interface_has_their_address() {
    let Some(network) = Network::open() else { return };
    network.far("ip addr add 10.9.0.2/24 dev v1");
    let mut daemon = network.daemon(
        "acquisition.rate_hz = 200\n[publishing]\ntcp = '10.9.0.1:7361'\nudp = []\nsubscribe = '10.9.0.1:7363'\n\
         allow = ['10.0.0.0/8']\n[monitor]\nlisten = '[fd00:9::1]:7360'",
    );
    daemon.subscriptions();
    for listener in ["10.9.0.1:7361", "10.9.0.1:7363", "[fd00:9::1]:7360"] {
        let told =
            |line: &&Value| line["address"] == listener && line.to_string().contains("no interface has");
        assert!(daemon.log.iter().any(|line| told(&line)), "{listener}: {:#?}", daemon.log);
    }
    let endpoints = ["tcp://10.9.0.1:7361", "subscribe://10.9.0.1:7363"];
    network.near("ip addr add 10.9.0.1/24 dev v0");
    let mut receivers = endpoints.map(|endpoint| network.watch(endpoint));
    for receiver in &mut receivers {
        receiver.goes_on(RATE);
    }
    network.near("ip addr del 10.9.0.1/24 dev v0");
    fails(&daemon, "10.9.0.2");
    network.near("ip addr add 10.9.0.1/24 dev v0");
    for receiver in &mut receivers {
        receiver.goes_on(AWAITED);
    }
}
