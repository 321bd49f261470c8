//! The metrics compared with the documents, the stream and the dashboard.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use super::page::{Metrics, OPEN_METRICS, TEXT, until};
use crate::testkit::http::get;
use crate::testkit::venv::succeeded;
use crate::testkit::{Daemon, Folder, Stream, wait_for};

fn read(path: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap()
}

/// The metrics of a daemon that has run long enough to report all of them.
fn complete() -> Metrics {
    let mut daemon = Daemon::start("monitor.listen = \"127.0.0.1:0\"");
    let at = daemon.monitor();
    wait_for("the trend", || {
        let metrics = Metrics::of(at);
        let complete = metrics.0.contains_key("trifacet_power_trend_watts_per_second");
        if complete { Ok(metrics) } else { Err("no trend".into()) }
    })
}

/// Type, labels and meaning by name.
type Table = BTreeMap<String, [String; 3]>;

/// The metrics that every daemon has. Those of the drift need a calibration record: `daemon::calibration_drift`.
fn documented() -> Table {
    let page = read("docs/monitoring.md");
    let rows = page.lines().filter(|line| line.starts_with("| `trifacet_"));
    let cells = rows.map(|row| row.split('|').map(|cell| cell.trim().replace('`', "")).collect::<Vec<_>>());
    let table = cells.map(|cells| (cells[1].clone(), [2, 3, 4].map(|i| cells[i].clone())));
    table.filter(|(name, _)| !name.starts_with("trifacet_calibration_")).collect()
}

fn live(metrics: &Metrics) -> Table {
    let row = |family: &super::page::Family| {
        let labels = family.samples.iter().flat_map(|(_, labels, _)| labels.keys());
        let labels: BTreeSet<_> = labels.map(String::as_str).filter(|label| *label != "le").collect();
        let labels = labels.into_iter().collect::<Vec<_>>().join(", ");
        [family.kind.clone(), labels, family.meaning.clone()]
    };
    metrics.0.iter().map(|(name, family)| (name.clone(), row(family))).collect()
}

/// All words of a file that look like names of samples.
fn names(text: &str) -> BTreeSet<&str> {
    let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_'));
    words.filter(|word| word.starts_with("trifacet_")).collect()
}

#[test]
fn table_dashboard_and_alerts_agree_with_the_live_metrics() {
    let metrics = complete();
    assert_eq!(documented(), live(&metrics), "left: docs/monitoring.md, right: the live page");

    let samples: BTreeSet<_> =
        metrics.0.values().flat_map(|f| &f.samples).map(|(name, ..)| &name[..]).collect();
    for (file, least) in [("monitoring/grafana-dashboard.json", 40), ("monitoring/alerts.yml", 6)] {
        let text = read(file);
        let used = names(&text);
        assert!(used.len() >= least, "{file}: {used:?}");
        let unknown: Vec<_> = used.difference(&samples).collect();
        assert!(unknown.is_empty(), "{file} refers to unknown metrics {unknown:?}");
    }
}

/// The names and labels of all samples.
fn samples(metrics: &Metrics) -> BTreeSet<(String, String)> {
    let all = metrics.0.values().flat_map(|family| &family.samples);
    all.map(|(name, labels, _)| (name.clone(), format!("{labels:?}"))).collect()
}

/// `promtool`, fetched if it is missing.
fn promtool() -> PathBuf {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/system/monitor/promtool.sh");
    let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join("promtool");
    let output = succeeded(Command::new("bash").arg(script).arg(place), "promtool cannot be fetched");
    PathBuf::from(String::from_utf8(output.stdout).unwrap().trim())
}

#[test]
fn a_scraper_gets_the_format_it_asks_for() {
    let mut daemon = Daemon::start("monitor.listen = \"127.0.0.1:0\"");
    let at = daemon.monitor();
    until(at, "ready", |ready| ready["ready"] == true);
    // Gauges of the last second are absent if it had no frame, which can happen on a busy machine.
    let (open, text) = wait_for("the same samples in both formats", || {
        let (open, page) = Metrics::read(at, &OPEN_METRICS);
        assert!(page.ends_with("# EOF\n"), "{page}");
        let (text, page) = Metrics::read(at, &TEXT);
        assert!(!page.contains("# EOF") && !page.contains(" info\n"), "{page}");
        let [of_open, of_text] = [samples(&open), samples(&text)];
        let different: Vec<_> = of_open.symmetric_difference(&of_text).cloned().collect();
        if different.is_empty() { Ok((open, text)) } else { Err(format!("{different:?}")) }
    });
    let kind = |metrics: &Metrics, name: &str| metrics.0[name].kind.clone();
    for name in ["trifacet_scans_total", "trifacet_ready", "trifacet_solve_delay_seconds"] {
        assert_eq!(kind(&text, name), kind(&open, name), "{name}");
        assert_eq!(text.0[name].meaning, open.0[name].meaning);
    }
    assert_eq!(kind(&text, "trifacet_build_info"), "gauge");

    // Without a preference, as from curl, the page is of the format that every tool reads.
    let plain = get(at, "/metrics");
    assert!(plain.headers.contains(&format!("content-type: {}", TEXT.content_type)), "{plain:?}");
    assert!(plain.headers.contains("vary: accept"), "{plain:?}");
    let folder = Folder::new();
    let file = folder.write("metrics", &plain.body);
    let mut check = Command::new(promtool());
    let checked = succeeded(check.args(["check", "metrics"]).stdin(File::open(file).unwrap()), &plain.body);
    let complaints = [checked.stdout, checked.stderr].map(|text| String::from_utf8(text).unwrap()).concat();
    assert_eq!(complaints, "");
}

#[test]
fn the_dashboard_has_the_format_of_grafana() {
    let dashboard: Value = serde_json::from_str(&read("monitoring/grafana-dashboard.json")).unwrap();
    assert!(dashboard["schemaVersion"].as_i64().unwrap() >= 38, "of Grafana 10");
    assert_eq!(dashboard["uid"], "trifacet");
    let panels = dashboard["panels"].as_array().unwrap();
    let ids: BTreeSet<_> = panels.iter().map(|panel| panel["id"].as_i64().unwrap()).collect();
    assert_eq!(ids.len(), panels.len(), "ids are unique");
    for panel in panels {
        let place = &panel["gridPos"];
        assert!(place["x"].as_i64().unwrap() + place["w"].as_i64().unwrap() <= 24, "{panel}");
        let targets = panel["targets"].as_array().unwrap();
        assert!(!targets.is_empty() && targets.iter().all(|t| t["expr"].is_string()), "{panel}");
        assert_eq!(panel["datasource"]["uid"], "${datasource}", "{panel}");
    }
}

#[test]
fn counters_and_sums_are_those_of_the_stream() {
    let config = "monitor.listen = \"127.0.0.1:0\"\nacquisition.rate_hz = 200\n\
        twin.fault = [{ kind = 'dropped', fraction = 0.2, at_s = 1, for_s = 1 }, { kind = 'stalled', at_s = 4 }]";
    let mut daemon = Daemon::start(config);
    let mut stream = Stream::tcp(daemon.address());
    let at = daemon.monitor();
    let mut frames = stream.through("silence", |frame| !frame.of_samples() && frame.sample_index > 500);
    until(at, "stalled", |ready| ready["checks"][0]["ok"] == false);
    // Without samples, the counters of samples do not change any more.
    let heartbeat = stream.heartbeat();
    let metrics = Metrics::of(at);
    for (name, count) in &heartbeat.counters {
        let sample = format!("trifacet_{name}_total");
        if name.starts_with("frames") {
            assert!(metrics.value(&sample, "") >= *count as f64, "{name}");
        } else {
            assert!((metrics.value(&sample, "") - *count as f64).abs() < 0.5, "{name}");
        }
    }
    assert!(heartbeat.counters["scans_lost"] > 10, "{heartbeat:?}");
    assert!((metrics.value("trifacet_clients", "tcp") - 1.0).abs() < 0.5);

    // The stream has all frames except those before its connection; the metrics contain their totals.
    let first = frames[0].sequence;
    frames.retain(crate::testkit::Frame::of_samples);
    let solved = metrics.value("trifacet_solve_delay_seconds_count", "");
    assert!(solved >= frames.len() as f64 && solved <= (frames.len() as u64 + first) as f64, "{solved}");
    let lost = frames.iter().filter(|frame| frame.lost > 0).count() as f64;
    assert!((metrics.value("trifacet_status_frames_total", "SAMPLE_GAP") - lost).abs() < 0.5);
    let total =
        frames.iter().rev().take(100).map(|f| f64::from(f.powers.iter().sum::<f32>())).sum::<f64>() / 100.0;
    assert!((total - 0.6e-3).abs() < 1e-5, "{total}");
}
