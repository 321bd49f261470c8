//! The cause of the lock state is part of the state: every output shows it, also long after the change.

use std::io::{BufRead, BufReader, Write};
use std::net::{SocketAddr, TcpStream};

use serde_json::Value;
use trifacet::client::{Client, Endpoint, LockEvent, Message, Options};

use crate::testkit::http::get;
use crate::testkit::{Daemon, PATIENCE, Stream, run, trifacet, wait_for};

/// The stage moves the beam the other way than the loop expects: the loop finds and loses the apex until it
/// gives up.
const REVERSED: &str =
    "twin.steering.matrix = [[-1.0, 0.0], [0.0, -1.0]]\nmonitor.listen = \"127.0.0.1:0\"\n";
const WRONG_MATRIX: &str = "found and lost too often (is steering.matrix right?)";

/// A daemon whose loop has given up.
fn gave_up() -> (Daemon, Value) {
    let mut daemon = Daemon::start(REVERSED);
    daemon.monitor(); // the last of its ports
    let status = daemon.status_until(|status| status["loop"]["cause"] == "lost_too_often");
    (daemon, status)
}

/// A text client: sends a line and passes every answer to `is` until it is the right one.
fn talk(at: SocketAddr, line: &str, is: impl Fn(&str) -> bool) -> String {
    let mut socket = TcpStream::connect(at).unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    writeln!(socket, "{line}").unwrap();
    let mut lines = BufReader::new(socket).lines();
    lines.find_map(|line| line.ok().filter(|line| is(line))).expect("the line in time")
}

#[test]
fn every_output_shows_why_the_loop_has_given_up() {
    let (mut daemon, status) = gave_up();
    let control_loop = &status["loop"];
    assert_eq!(control_loop["lock"], "held");
    assert!(control_loop["cause_text"].as_str().unwrap().contains(WRONG_MATRIX), "{control_loop}");
    assert!(control_loop["lock_since"].as_str().unwrap().ends_with('Z'), "{control_loop}");

    let line = daemon.says("the loop gives up", |line| {
        line["cause"].as_str().is_some_and(|cause| cause.contains(WRONG_MATRIX))
    });
    assert_eq!((&line["level"], &line["to"]), (&"WARN".into(), &"held".into()), "{line}");

    let at = daemon.address();
    for query in ["pose?", "status?"] {
        let answer = talk(at, query, |_| true);
        assert!(answer.contains(" lock=held ") && answer.ends_with(" cause=lost_too_often"), "{answer}");
    }
    let socket = daemon.socket();
    for socket in [socket.to_str().unwrap(), "/nonexistent"] {
        let endpoint = format!("tcp://{at}");
        let screen = run(&mut trifacet(&["status", &endpoint, "--socket", socket]));
        let cause = screen.out.lines().find(|line| line.starts_with("cause "));
        assert!(cause.is_some_and(|line| line.contains(WRONG_MATRIX)), "{}", screen.out);
    }
    let monitor = daemon.monitor();
    // The monitor takes the frames in batches: it may show the state before for some frames.
    let reason = wait_for("the reason in /readyz", || {
        let ready: Value = serde_json::from_str(&get(monitor, "/readyz").body).unwrap();
        let check = ready["checks"].as_array().unwrap().iter().find(|check| check["name"] == "lock").unwrap();
        let reason = check["reason"].as_str().unwrap().to_owned();
        if reason.starts_with("held: ") { Ok(reason) } else { Err(reason) }
    });
    assert!(reason.contains(WRONG_MATRIX), "{reason}");
    let metrics = get(monitor, "/metrics").body;
    let causes: Vec<_> =
        metrics.lines().filter(|l| l.starts_with("trifacet_lock_cause{") && l.ends_with(" 1")).collect();
    assert_eq!(causes, ["trifacet_lock_cause{cause=\"lost_too_often\"} 1"]);
}

fn events_of(client: &mut Client, runtime: &tokio::runtime::Runtime) -> LockEvent {
    runtime.block_on(async {
        loop {
            let message = tokio::time::timeout(PATIENCE, client.next()).await.expect("an event in time");
            if let Message::Event(event) = message.unwrap() {
                return event;
            }
        }
    })
}

#[test]
fn a_client_that_requests_events_gets_the_state_at_once_and_then_every_change() {
    let (mut daemon, _) = gave_up();
    let at = daemon.address();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let options = Options { events: true, ..Options::default() };
    let endpoint = Endpoint::Tcp(at.to_string());
    let mut client = runtime.block_on(Client::connect_with(&endpoint, options)).unwrap();
    let mut plain = Stream::tcp(at); // fails on a message that it has not requested
    let now = events_of(&mut client, &runtime);
    assert_eq!((now.lock.as_str(), now.cause.as_str()), ("held", "lost_too_often"));
    assert!(now.text.contains(WRONG_MATRIX) && now.number > 10, "{now:?}");

    daemon.told(&["loop", "off"]);
    let off = events_of(&mut client, &runtime);
    assert_eq!(
        (off.number, off.from.as_str(), off.lock.as_str(), off.cause.as_str()),
        (now.number + 1, "held", "off", "switched_off")
    );
    assert!(off.since > now.since, "{off:?} {now:?}");
    plain.until("a frame after the change", |frame| frame.lock.name() == "off");

    let json = talk(at, "stream format=json divider=1000 events=on", |line| line.starts_with("{\"event\""));
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["event"]["cause"], "switched_off");
    let csv = talk(at, "stream format=csv divider=1000 events=on", |line| line.starts_with("# event "));
    let csv: Value = serde_json::from_str(csv.trim_start_matches("# event ")).unwrap();
    // Each reading of the two clocks differs by some nanoseconds.
    let [csv, json] = [&csv, &json["event"]].map(|event| {
        let mut event = event.clone();
        let since = event["since"].take();
        (event, since.as_str().unwrap()[.."2026-11-30T18:49:32.692".len()].to_owned())
    });
    assert_eq!(csv, json);
}
