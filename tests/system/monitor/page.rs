//! Health and metrics, read as by programs.

use std::collections::BTreeMap;
use std::io::Write;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

use serde::Deserialize;
use serde_json::Value;

use crate::testkit::http::{ask, get};
use crate::testkit::{venv, wait_for};

/// `/readyz`, with a check that the code agrees with the content.
pub(crate) fn readyz(at: SocketAddr) -> Value {
    let page = get(at, "/readyz");
    let ready: Value = serde_json::from_str(&page.body).unwrap();
    assert_eq!(page.code, if ready["ready"] == true { 200 } else { 503 }, "{page:?}");
    let checks = ready["checks"].as_array().unwrap();
    assert_eq!(ready["ready"], checks.iter().all(|check| check["ok"] == true), "{ready}");
    assert!(checks.iter().all(|check| check["reason"].is_null() == (check["ok"] == true)), "{ready}");
    ready
}

/// Requests `/readyz` until it fulfils this condition.
pub(crate) fn until(at: SocketAddr, what: &str, is: impl Fn(&Value) -> bool) -> Value {
    wait_for(what, || {
        let ready = readyz(at);
        if is(&ready) { Ok(ready) } else { Err(ready.to_string()) }
    })
}

/// Checks the metrics while a part of the daemon is stalled.
pub(crate) fn nothing_stays_green(at: SocketAddr) {
    let metrics = get(at, "/metrics").body;
    assert!(metrics.contains("trifacet_ready{check=\"lock\"} 0"), "{metrics}");
    assert!(!metrics.contains("trifacet_lock_state{state=\"locked\"} 1"), "{metrics}");
    let states: Vec<_> = metrics.lines().filter(|line| line.starts_with("trifacet_lock_state{")).collect();
    let one = states.iter().filter(|line| line.ends_with(" 1")).count() == 1;
    assert!(states.is_empty() || one, "exactly one lock state, or no known one: {states:?}");
}

/// A family of metrics as parsed by the Prometheus library.
#[derive(Debug, Deserialize)]
pub(crate) struct Family {
    pub(crate) name: String,
    #[serde(rename = "type")]
    pub(crate) kind: String,
    pub(crate) meaning: String,
    pub(crate) samples: Vec<(String, BTreeMap<String, String>, f64)>,
}

/// What a scraper accepts, and what it then gets.
pub(crate) struct Scrape {
    pub(crate) accept: &'static str,
    pub(crate) content_type: &'static str,
    /// The parser of the Prometheus library.
    pub(crate) parser: &'static str,
}

pub(crate) const OPEN_METRICS: Scrape = Scrape {
    accept: "application/openmetrics-text;version=1.0.0;q=0.5,text/plain;version=0.0.4;q=0.3,*/*;q=0.2",
    content_type: "application/openmetrics-text; version=1.0.0; charset=utf-8",
    parser: "openmetrics",
};
pub(crate) const TEXT: Scrape =
    Scrape { accept: "text/plain", content_type: "text/plain; version=0.0.4; charset=utf-8", parser: "text" };

/// The metrics by name.
pub(crate) struct Metrics(pub(crate) BTreeMap<String, Family>);

impl Metrics {
    /// As Prometheus reads them.
    pub(crate) fn of(at: SocketAddr) -> Self {
        Self::read(at, &OPEN_METRICS).0
    }

    /// As this scraper reads them, and the text of the page.
    pub(crate) fn read(at: SocketAddr, scrape: &Scrape) -> (Self, String) {
        let page = ask(at, "/metrics", &format!("Host: {at}\r\nAccept: {}\r\n", scrape.accept));
        assert_eq!(page.code, 200);
        assert!(page.headers.contains(&format!("content-type: {}", scrape.content_type)), "{page:?}");
        let mut parser = Command::new(python())
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/system/monitor/parse.py"))
            .arg(scrape.parser)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        parser.stdin.take().unwrap().write_all(page.body.as_bytes()).unwrap();
        let output = parser.wait_with_output().unwrap();
        assert!(output.status.success(), "{}", page.body);
        let families: Vec<Family> = serde_json::from_slice(&output.stdout).unwrap();
        let families = families.into_iter().map(|family| (family.name.clone(), family)).collect();
        (Self(families), page.body)
    }

    /// The value of this sample with this value of its label, or without a label.
    pub(crate) fn value(&self, sample: &str, label: &str) -> f64 {
        let samples = self.0.values().flat_map(|family| &family.samples);
        let mut fit = samples.filter(|(name, labels, _)| {
            name == sample && labels.values().map(String::as_str).eq((!label.is_empty()).then_some(label))
        });
        fit.next().unwrap_or_else(|| panic!("no {sample} {label}")).2
    }
}

fn python() -> &'static PathBuf {
    static VENV: OnceLock<PathBuf> = OnceLock::new();
    VENV.get_or_init(|| venv::python("monitor-venv", "prometheus_client", &["prometheus_client==0.23.1"]))
}
