//! Memory and processor time of the page. These are commands and not tests, because they take long:
//!
//! ```text
//! SOAK_MINUTES=30 cargo test --test system page::soak::soak -- --exact --ignored --nocapture
//! cargo test --test system viewers_cost -- --ignored --nocapture
//! ```

use std::time::Duration;

use serde_json::json;
use tungstenite::Message;

use super::socket::connect;
use super::{daemon, page};
use crate::testkit::Browser;

/// Limit on the growth of the daemon, MB: the history for the charts, with the spare capacity of its
/// containers.
const PAST_MB: f64 = 8.0;

fn resident_mb(pid: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<f64>().unwrap() / 1024.0
}

/// Memory of the script of the page, MB, after garbage collection, and the number of elements.
fn heap(page: &mut Browser) -> (f64, f64) {
    page.call("HeapProfiler.collectGarbage", &json!({}));
    let metrics = page.call("Performance.getMetrics", &json!({}));
    let of = |name: &str| {
        let all = metrics["metrics"].as_array().unwrap();
        all.iter().find(|metric| metric["name"] == name).unwrap()["value"].as_f64().unwrap()
    };
    (of("JSHeapUsedSize") / 1_048_576.0, of("Nodes"))
}

#[test]
#[ignore = "a command: takes half an hour"]
fn soak() {
    let minutes: u32 = std::env::var("SOAK_MINUTES").map_or(30, |text| text.parse().unwrap());
    let (daemon, mut stream, at) = daemon("");
    let mut page = page(at);
    page.call("Network.disable", &json!({})); // otherwise the browser keeps every message for the test
    page.call("Performance.enable", &json!({}));
    page.until("document.querySelectorAll('.strips canvas').length >= 6");
    // The charts are full after a minute; after that, the memory must not grow.
    std::thread::sleep(Duration::from_secs(75));
    let (mut heaps, mut residents) = (vec![], vec![]);
    println!("minute  page MB  elements  daemon MB");
    for minute in 0..=minutes {
        let ((mb, nodes), daemon_mb) = (heap(&mut page), resident_mb(daemon.pid()));
        println!("{minute:6}  {mb:7.2}  {nodes:8}  {daemon_mb:9.2}");
        heaps.push(mb);
        residents.push(daemon_mb);
        if minute < minutes {
            for _ in 0..60 {
                stream.skip_to_now();
                std::thread::sleep(Duration::from_secs(1));
            }
        }
    }
    let third = heaps.len() / 3;
    let most = |list: &[f64]| list.iter().copied().fold(0.0, f64::max);
    let (first, last) = (most(&heaps[..=third]), most(&heaps[heaps.len() - 1 - third..]));
    assert!(last < first * 1.1 + 0.5, "the page grew from {first} to {last} MB");
    let grown = residents.last().unwrap() - residents[0];
    assert!(grown < PAST_MB, "the daemon grew by {grown} MB");
    assert_eq!(page.complaints(), Vec::<String>::new());
}

/// Processor time so far, seconds: of the fast thread, and of all others.
fn busy_s(pid: u32) -> [f64; 2] {
    let mut busy = [0.0; 2];
    for task in std::fs::read_dir(format!("/proc/{pid}/task")).unwrap() {
        let stat = std::fs::read_to_string(task.unwrap().path().join("stat")).unwrap();
        let (name, rest) = stat.rsplit_once(") ").unwrap();
        let ticks: f64 = rest.split(' ').skip(11).take(2).map(|n| n.parse::<f64>().unwrap()).sum();
        busy[usize::from(!name.ends_with("(fast"))] += ticks / 100.0;
    }
    busy
}

#[test]
#[ignore = "a command that measures"]
fn viewers_cost() {
    const SECONDS: u64 = 20;
    let (daemon, mut stream, at) = daemon("acquisition.rate_hz = 10000\npublishing.tcp_queue = 65536\n");
    stream.locked();
    println!("viewers  fast thread  others   (share of a CPU, 10 kHz)");
    let mut viewers = 0;
    for wanted in [0, 1, 20, 40] {
        while viewers < wanted {
            let mut socket = connect(at, None).unwrap();
            socket.send(Message::text("{\"watch\": 60}")).unwrap();
            std::thread::spawn(move || while socket.read().is_ok() {});
            viewers += 1;
        }
        let before = busy_s(daemon.pid());
        for _ in 0..SECONDS {
            stream.skip_to_now();
            std::thread::sleep(Duration::from_secs(1));
        }
        let after = busy_s(daemon.pid());
        let share = |i: usize| 100.0 * (after[i] - before[i]) / SECONDS as f64;
        println!("{viewers:7}  {:10.1} %  {:5.1} %", share(0), share(1));
    }
    stream.skip_to_now();
    let counters = stream.heartbeat().counters;
    for loss in ["scans_lost", "estimation_overflows", "monitor_overflows", "page_skips"] {
        assert_eq!(counters[loss], 0, "{loss}");
    }
}
