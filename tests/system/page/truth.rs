//! The page agrees with the stream within a second, and marks its data as old without updates.

use std::net::SocketAddr;

use serde_json::Value;
use trifacet_wire::Status;

use super::{DESK, FINE, daemon, page};
use crate::testkit::{Board, Browser, Daemon, Stream};

/// A daemon on a board, whose light fails on an order of the test.
fn on_board() -> (Board, Daemon, Stream, SocketAddr) {
    let board = Board::start("");
    let port = board.link();
    let config = format!("acquisition.source = 'serial'\nacquisition.serial.port = '{}'\n", port.display());
    let (daemon, stream, at) = daemon(&config);
    (board, daemon, stream, at)
}

/// The contents of the table of poses, with the frame that they belong to.
fn shown(page: &mut Browser) -> Value {
    page.eval(
        "({ sample: Number(document.querySelector('#pose').dataset.sample),
            now: [...document.querySelectorAll('#pose .now')].map((e) => e.textContent),
            sd: [...document.querySelectorAll('#pose .sd')].map((e) => e.textContent) })",
    )
}

fn number(text: &Value) -> f64 {
    text.as_str().unwrap().replace('\u{2212}', "-").parse().unwrap()
}

#[test]
fn the_page_loads_only_from_the_daemon_and_agrees_with_the_stream() {
    let (_daemon, mut stream, at) = daemon("");
    let mut page = page(at);
    page.until("document.querySelectorAll('.strips canvas').length >= 6");
    let mut before = 0;
    for _ in 0..5 {
        page.until(&format!("Number(document.querySelector('#pose').dataset.sample) > {before}"));
        let shown = shown(&mut page);
        let sample = shown["sample"].as_u64().unwrap();
        let frame = stream.until("the same sample", |frame| frame.sample_index >= sample);
        assert_eq!(frame.sample_index, sample);
        before = sample;
        for axis in 0..6 {
            let (now, sd) = (number(&shown["now"][axis]), number(&shown["sd"][axis]));
            assert!((now - frame.pose[axis] * 1e6).abs() < 0.0051, "{axis}: {shown} {frame:?}");
            assert!(
                (sd - f64::from(frame.deviations[axis]) * 1e6).abs() < 0.0051,
                "{axis}: {shown} {frame:?}"
            );
        }
        // Within one refresh.
        let newest = page.eval("Number(document.querySelector('#pose').dataset.time)").as_f64().unwrap();
        let now = page.eval("Date.now()").as_f64().unwrap();
        assert!(now - newest < 2000.0, "the table is {} ms old", now - newest);
    }
    let units = "(() => { const s = document.querySelector('#units'); s.value = 'mm'; s.dispatchEvent(new Event('change')); })()";
    page.eval(units);
    page.until("document.querySelector('#pose .unit').textContent === 'mm'");
    let elsewhere: Vec<_> = page
        .requests()
        .into_iter()
        .filter(|url| {
            ![format!("http://{at}/"), format!("ws://{at}/"), "data:".into()]
                .iter()
                .any(|own| url.starts_with(own))
        })
        .filter(|url| url != "about:blank")
        .collect();
    assert_eq!(elsewhere, Vec::<String>::new());
    assert!(page.requests().iter().any(|url| url.ends_with("/uplot.js")));
    assert_eq!(page.complaints(), Vec::<String>::new());
}

/// Records each new headline with the time of the newest frame on the page.
const NOTES: &str = "(() => {
    window.notes = [];
    const text = document.querySelector('#headline .text');
    new MutationObserver(() => setTimeout(() => notes.push([Number(document.querySelector('#pose').dataset.time), text.textContent]), 0))
        .observe(text, { childList: true, characterData: true, subtree: true });
})()";

#[test]
fn the_headline_states_a_blocked_beam_and_the_recovery_within_a_second() {
    let (mut board, _daemon, mut stream, at) = on_board();
    let mut page = page(at);
    page.eval(NOTES);
    board.order("beam-blocked 6");
    let dark = stream.until("dark", |frame| frame.has(Status::PSD_A_LOW));
    // All in one evaluation, because the light returns by itself.
    page.until(
        "notes.some(([, text]) => text.includes('too little light on PSD A, B, C'))
            && document.querySelector('#headline').dataset.grade === 'bad'
            && document.querySelector('#pose .now').textContent === '–'
            && document.querySelector('#faults').innerText.includes('PSD_B_LOW, since')",
    );
    let locked = stream.until("locked again", |frame| frame.time_ns > dark.time_ns && frame.locked());
    page.until(FINE);
    // All lines of all axes have the gap.
    page.until("[...document.querySelectorAll('.strips .chart')].every((e) => e.chart?.data.slice(1).every((y) => y.includes(null)))");
    let notes = page.eval("notes");
    let first = |is: &dyn Fn(&str) -> bool, after: f64| {
        let notes = notes.as_array().unwrap();
        let found = notes.iter().find(|n| n[0].as_f64().unwrap() >= after && is(n[1].as_str().unwrap()));
        found.unwrap_or_else(|| panic!("{notes:?}"))[0].as_f64().unwrap()
    };
    let dark_ms = dark.time_ns as f64 * 1e-6;
    let reported = first(&|text| text.contains("too little light"), dark_ms);
    assert!(reported - dark_ms < 1000.0, "reported after {} ms", reported - dark_ms);
    let locked_ms = locked.time_ns as f64 * 1e-6;
    let reported = first(&|text| text.contains("locked") && text.contains("valid,"), locked_ms - 200.0);
    assert!(reported - locked_ms < 1000.0, "reported after {} ms", reported - locked_ms);
    assert_eq!(page.complaints(), Vec::<String>::new());
}

#[test]
fn without_a_board_the_page_reports_no_samples_and_shows_no_values() {
    let (_daemon, _stream, at) =
        daemon("acquisition.source = 'serial'\nacquisition.serial.port = '/nowhere/board'\n");
    let mut page = Browser::open(&format!("http://{at}/"), DESK);
    page.until(
        "/No valid pose: no samples: .*\\/nowhere\\/board.* since/.test(document.querySelector('#headline')?.innerText)",
    );
    page.until("document.querySelectorAll('#latency dd').length >= 5");
    page.until("document.querySelector('#beam-facts').innerText.includes('no samples')"); // the cause
    let told = page.eval(
        "[...document.querySelectorAll('.psd .none, #balance .none, #latency dd, #beam-facts dd')].map((e) => e.textContent)",
    );
    let told: Vec<_> = told.as_array().unwrap().iter().map(|text| text.as_str().unwrap()).collect();
    assert_eq!(told.iter().filter(|text| **text == "no samples").count(), 5, "{told:?}");
    assert_eq!(told.iter().filter(|text| **text == "–").count(), 9, "{told:?}");
    assert_eq!(page.eval("document.querySelector('.spectra').hidden"), true);
    assert_eq!(page.complaints(), Vec::<String>::new());
}

#[test]
fn a_spectrum_without_new_data_is_marked_as_old() {
    let (mut board, _daemon, _stream, at) = on_board();
    let mut page = page(at);
    // Each in one evaluation, because the state changes by itself.
    let shows = |text: &str, opacity: &str| {
        format!(
            "document.querySelector('#spectrum-facts').textContent.startsWith('{text}')
                && getComputedStyle(document.querySelector('.spectra')).opacity === '{opacity}'"
        )
    };
    page.until(&shows("Welch", "1"));
    board.order("beam-blocked 8");
    page.until(&shows("Old, from ", "0.35"));
    page.until(&shows("Welch", "1"));
}

#[test]
fn a_task_that_stalls_is_named_before_the_daemon_ends() {
    let (daemon, _stream, at) = daemon("realtime.stall_ms = 4000\n");
    let mut page = page(at);
    page.until("document.querySelectorAll('.strips canvas').length >= 6");
    page.eval(NOTES);
    daemon.told(&["drill", "stall", "centering"]);
    let headline = |text: &str| format!("notes.some(([, text]) => text.startsWith('{text}'))");
    page.until(&headline("Pose valid, beam not locked (held): task centering stalled since "));
    page.until("document.querySelector('#faults li').innerText.includes('Fault: task centering stalled')");
    assert_eq!(page.eval("document.body.classList.contains('stale')"), false, "poses arrive");
    page.until(&headline("No connection"));
}

#[test]
fn the_page_states_that_the_twin_has_a_head_of_its_own() {
    for (config, said) in [
        ("[twin.beam]\nellipse = [0.01, 0.0]\n", "digital twin with a head of its own, "),
        ("", "digital twin, "),
    ] {
        let (_daemon, _stream, at) = daemon(config);
        let mut page = page(at);
        page.until(&format!("document.querySelector('#device').textContent.startsWith('{said}')"));
    }
}

#[test]
fn without_a_daemon_the_page_turns_grey_and_a_new_daemon_revives_it() {
    let (first, _stream, at) = daemon("");
    let mut page = page(at);
    drop(first);
    page.until("document.querySelector('#headline .text').textContent.startsWith('No connection since ')");
    assert_eq!(page.eval("document.body.classList.contains('stale')"), true);
    assert_eq!(page.eval("getComputedStyle(document.querySelector('#pose')).opacity"), "0.35");
    let _second = Daemon::start(&format!("monitor.listen = \"{at}\""));
    page.until(FINE);
}

#[test]
fn the_page_distinguishes_a_stopped_daemon_from_an_ended_one() {
    use rustix::process::Signal;
    let (mut daemon, _stream, at) = daemon("");
    let mut page = page(at);
    daemon.signal(Signal::STOP);
    page.until(
        "document.querySelector('#headline .text').textContent.startsWith('No updates from the daemon since ')",
    );
    assert_eq!(page.eval("document.body.classList.contains('stale')"), true);
    daemon.signal(Signal::CONT);
    page.until(FINE);
    daemon.ends_in_order(Signal::TERM);
    page.until("document.querySelector('#headline .text').textContent.startsWith('No connection')");
}

/// Number of updates made for viewers so far.
fn updates(stream: &mut Stream) -> u64 {
    stream.heartbeat().counters["page_updates"]
}

#[test]
fn a_hidden_page_receives_no_updates_and_returns_with_its_whole_history() {
    let (_daemon, mut stream, at) = daemon("");
    let mut page = page(at);
    page.until("document.querySelectorAll('.strips canvas').length >= 6");
    page.hide();
    page.until("document.hidden");
    stream.skip_to_now();
    updates(&mut stream); // an update may have been in transit
    let before = updates(&mut stream);
    stream.take(3000);
    stream.skip_to_now();
    assert_eq!(updates(&mut stream), before, "updates without a viewer");
    page.show();
    page.until(FINE);
    assert!(updates(&mut stream) > before);
    page.until("document.querySelector('.strips .chart').chart?.data[0].length > 30");
    // There is no gap for the time in which the page was hidden.
    let holes =
        page.eval("document.querySelector('.strips .chart').chart.data[3].filter((y) => y === null).length");
    assert_eq!(holes, 0);
}
