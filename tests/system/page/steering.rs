//! Commands from the page: only if the configuration permits them, and only with the token.

use std::net::SocketAddr;

use serde_json::Value;
use trifacet_wire::LockState;

use super::{daemon, page};
use crate::testkit::{Daemon, Stream, http};

const TOKEN: &str = "an-honest-secret-of-the-lab";

/// Sends a command and returns the code and the JSON of the answer.
fn post(at: SocketAddr, headers: &str, body: &str) -> (u16, Value) {
    let page = http::post(at, "/control", headers, body);
    (page.code, serde_json::from_str(&page.body).unwrap_or_else(|e| panic!("{e}: {page:?}")))
}

fn headers(token: &str) -> String {
    format!("Content-Type: application/json\r\nAuthorization: Bearer {token}\r\n")
}

#[test]
fn commands_need_permission_and_the_token() {
    let (_daemon, mut stream, at) = daemon("");
    let order = "{\"command\": \"loop off\"}";
    let (code, answer) = post(at, &headers(TOKEN), order);
    assert!(code == 403 && answer["error"].as_str().unwrap().contains("monitor.control"), "{answer}");
    stream.locked();
    drop(stream);
    let (mut daemon, mut stream, at) = daemon_with_control();
    let evil = format!("{}Origin: http://127.0.0.1:1\r\n", headers(TOKEN));
    let form = format!("Content-Type: text/plain\r\nAuthorization: Bearer {TOKEN}\r\n");
    let bare = "Content-Type: application/json\r\n".to_owned();
    let basic = format!("{bare}Authorization: Basic {TOKEN}\r\n");
    let elsewhere = evil.replace("127.0.0.1:1", "evil.example");
    let secure = evil.replace("http://127.0.0.1:1", &format!("https://{at}"));
    let long = " ".repeat(3_000_000);
    for (headers, body, code) in [
        (&headers(&TOKEN.to_uppercase()), order, 401),
        (&headers(&TOKEN[1..]), order, 401),
        (&headers(""), order, 401),
        (&bare, order, 401),
        (&basic, order, 401),
        (&evil, order, 403),
        (&elsewhere, order, 403),
        (&secure, order, 403),
        (&form, order, 415),
        (&headers(TOKEN), &long, 413),
        (&headers(TOKEN), "{\"command\": \"tare save\"}", 400),
        (&headers(TOKEN), "{\"command\": \"gains 1 1\"}", 400),
        (&headers(TOKEN), "{\"command\": \"reload\"}", 400),
        (&headers(TOKEN), "{\"command\": \"\"}", 400),
        (&headers(TOKEN), "{\"order\": \"park\"}", 400),
        (&headers(TOKEN), "park", 400),
    ] {
        assert_eq!(post(at, headers, body).0, code, "{headers}{body}");
    }
    assert!(stream.take(200).iter().all(|frame| frame.lock != LockState::Off));
    stream.skip_to_now();
    let counters = stream.heartbeat().counters;
    assert_eq!((counters["monitor_denied"], counters["monitor_forbidden"]), (5, 3), "{counters:?}");
    assert_eq!(post(at, &headers(TOKEN), order).0, 200);
    stream.until("off", |frame| frame.lock == LockState::Off);
    daemon.ends_in_order(rustix::process::Signal::TERM);
    assert!(daemon.said("a command with a wrong token"));
    let done = daemon.log.iter().find(|line| line["command"] == "loop off").expect("the command in the log");
    assert!(done["peer"].as_str().is_some_and(|peer| peer.starts_with("127.0.0.1:")), "{done}");
    let peers: Vec<_> = daemon.log.iter().filter_map(|line| line["peer"].as_str()).collect();
    assert!(peers.iter().filter(|peer| peer.starts_with("127.0.0.1:")).count() >= 1, "{peers:?}");
    assert!(daemon.said("loop off") && !daemon.said(TOKEN), "the log: {:#?}", daemon.log);
}

fn daemon_with_control() -> (Daemon, Stream, SocketAddr) {
    daemon(&format!("monitor.control = true\nmonitor.token = \"{TOKEN}\"\n"))
}

#[test]
fn an_operator_with_the_token_steers_from_the_page() {
    let (_daemon, mut stream, at) = daemon_with_control();
    let mut page = page(at);
    let say = |token: &str, command: &str| {
        format!(
            "document.querySelector('#token').value = '{token}'; document.querySelector('[data-command=\"{command}\"]').click()"
        )
    };
    page.eval(&say("wrong-but-long-enough", "loop off"));
    page.until("document.querySelector('#answer').textContent.includes('wrong token')");
    for (command, state) in
        [("loop off", "off"), ("loop shadow", "off"), ("loop on", "locked"), ("park", "manual")]
    {
        page.eval(&say(TOKEN, command));
        page.until(&format!("document.querySelector('#answer').textContent === '● {command}: done'"));
        page.until(&format!("document.querySelector('#beam-facts').innerText.includes('{state}')"));
        let shadow = "document.querySelector('#headline').innerText.includes('off (loop in shadow mode)')";
        page.until(&format!("{shadow} === {}", command == "loop shadow"));
    }
    page.eval(&say(TOKEN, "loop on"));
    stream.skip_to_now();
    stream.locked();
    page.eval(&say(TOKEN, "tare"));
    page.until("document.querySelector('#answer').textContent === '● tare: done'");
    // Poses have another meaning: a mark, a badge, an event, and statistics without the jump.
    page.until("document.querySelector('#badges').innerText.includes('TARED')");
    page.until("/tare\\s*tare set/.test(document.querySelector('#events').innerText)");
    let chart = "document.querySelector('.strips .chart').chart";
    page.until(&format!("{chart}.data[0].length > 3 && document.title.includes('limited')"));
    let events = page.eval("document.querySelector('#events').innerText");
    let events = events.as_str().unwrap();
    assert!(events.contains("off after locked") || events.contains("manual after locked"), "{events}");
    assert!(events.contains("the monitor of the daemon has started"), "{events}");
    let text = page.eval("document.documentElement.innerHTML");
    assert!(!text.as_str().unwrap().contains(TOKEN), "the page shows the token");
    let refused = page.complaints();
    assert!(refused.iter().all(|complaint| complaint.contains("401")), "{refused:?}");
}
