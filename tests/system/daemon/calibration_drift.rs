//! A calibrated head that changes: it is named, with the quantity, the size and since when. One that does not change is not.

use serde_json::Value;

use super::standing_doubts::{doubt, stands};
use crate::testkit::http::get;
use crate::testkit::{Daemon, Folder, calibrated_twin, run, trifacet, wait_for};

/// A daemon with the calibrated configuration of the twin, in which these texts are replaced. Its folder also holds the
/// files that the configuration names.
fn daemon(changes: &[(&str, &str)]) -> Daemon {
    let (home, calibrated) = (Folder::new(), calibrated_twin());
    for name in ["psd-a.csv", "psd-b.csv", "psd-c.csv", "calibration.json"] {
        std::fs::copy(calibrated.path("calibrated").join(name), home.path(name)).unwrap();
    }
    let mut config = std::fs::read_to_string(calibrated.path("calibrated/trifacet.toml")).unwrap();
    for (from, to) in [&[("[publishing]\nudp = []\n", "")], changes].concat() {
        assert!(config.contains(from), "{from}: {config}");
        config = config.replacen(from, to, 1);
    }
    let mut daemon = Daemon::start_in(&home, &format!("monitor.listen = \"127.0.0.1:0\"\n{config}"));
    daemon.address(); // it has started
    daemon
}

/// What the control socket tells of the drift, once this part is known.
fn drift(daemon: &Daemon, part: &str) -> Value {
    wait_for(part, || {
        let drift = daemon.status()["calibration_drift"].clone();
        if drift[part].is_null() { Err(drift.to_string()) } else { Ok(drift) }
    })
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

#[test]
fn a_calibrated_head_that_does_not_change_is_not_doubted_and_its_drift_is_shown() {
    let dark = "[twin]\nfault = [{ at_s = 5, for_s = 0.5, kind = 'beam-blocked' }]\n";
    let mut daemon = daemon(&[("[twin]\n", dark)]);
    let drift = drift(&daemon, "dark_percent");
    let limit = number(&drift["limit_um"]);
    assert!((0.5..2.0).contains(&limit), "{drift}");
    for axis in 0..2 {
        assert!(number(&drift["residual_um"][axis]).abs() < limit / 2.0, "{drift}");
    }
    for psd in 0..3 {
        assert!(number(&drift["dark_percent"][psd]).abs() < 0.1, "{drift}");
    }
    assert_eq!(daemon.status()["doubts"], serde_json::json!([]));
    let metrics = get(daemon.monitor(), "/metrics").body;
    for (name, label) in [
        ("residual_drift_meters", "{axis=\"x\"}"),
        ("residual_drift_meters", "{axis=\"y\"}"),
        ("residual_drift_limit_meters", ""),
        ("power_gain_drift_ratio", "{psd=\"B\"}"),
        ("power_gain_drift_ratio", "{psd=\"C\"}"),
        ("dark_drift_ratio", "{psd=\"A\"}"),
    ] {
        let name = format!("trifacet_calibration_{name}{label} ");
        let value = metrics.lines().find_map(|line| line.strip_prefix(&name));
        let value: f64 = value.unwrap_or_else(|| panic!("{name}: {metrics}")).parse().unwrap();
        assert!(value.abs() < 0.01, "{name}{value}");
    }
    let endpoint = format!("tcp://{}", daemon.address());
    let status = run(trifacet(&["status", &endpoint, "--socket"]).arg(daemon.socket()));
    assert!(status.out.lines().any(|line| line.starts_with("drift     x ")), "{}", status.out);
    let doctor = run(trifacet(&["doctor", &endpoint, "--config"]).arg(daemon.file()));
    assert!(doctor.out.contains("the steering residual is that of the calibration: x "), "{}", doctor.out);
}

#[test]
fn a_power_gain_that_changed_is_named_with_its_size() {
    let mut daemon = daemon(&[("[twin]\n", "[twin.psd.b]\ngain = [1.0, 1.0, 1.05]\n[twin]\n")]);
    stands(&mut daemon, "calibration_drift", "the head has drifted since its calibration of 20");
    let drift = drift(&daemon, "power_gains_percent");
    let [b, c] = [0, 1].map(|psd| number(&drift["power_gains_percent"][psd]));
    assert!((4.0..6.0).contains(&b) && c.abs() < 1.0, "{drift}");
}

#[test]
fn a_gain_of_a_psd_that_changed_is_named() {
    let mut daemon = daemon(&[("[twin]\n", "[twin.psd.a]\ngain = [1.0, 0.99, 1.0]\n[twin]\n")]);
    stands(&mut daemon, "calibration_drift", "the mean steering residual has changed by");
}

/// The head warms up while the daemon runs.
#[test]
fn a_head_that_drifts_while_the_daemon_runs_is_named() {
    let warm = ("warm_up_k = 0.1\nwarm_up_s = 1800.0", "warm_up_k = 40.0\nwarm_up_s = 20.0");
    let mut daemon = daemon(&[warm]);
    stands(&mut daemon, "calibration_drift", "Poses are less accurate than they state");
}

/// 15 mV are 0.5 % of the usual sum of PSD B. Less than the dark offset is no ambient light.
#[test]
fn a_dark_reading_that_changed_is_named_when_the_beam_is_blocked() {
    let dark = ("0.002, 0.002, -0.002", "0.002, -0.013, -0.002");
    let fault = "[twin]\nfault = [{ at_s = 4, for_s = 0.5, kind = 'beam-blocked' }]\n";
    let mut daemon = daemon(&[dark, ("[twin]\n", fault)]);
    stands(&mut daemon, "dark_drift", "the dark readings have drifted since the calibration of 20");
    let drift = drift(&daemon, "dark_percent");
    assert!((-0.7..-0.3).contains(&number(&drift["dark_percent"][1])), "{drift}");
    assert!(doubt(&daemon.status(), "ambient_light").is_none());
}

#[test]
fn a_record_that_states_nothing_to_compare_with_leaves_the_watch_off() {
    let home = Folder::new();
    let calibrated = calibrated_twin();
    for name in ["psd-a.csv", "psd-b.csv", "psd-c.csv"] {
        std::fs::copy(calibrated.path("calibrated").join(name), home.path(name)).unwrap();
    }
    let record = std::fs::read_to_string(calibrated.path("calibrated/calibration.json")).unwrap();
    let mut record: Value = serde_json::from_str(&record).unwrap();
    assert!(record.as_object_mut().unwrap().remove("at_calibration").is_some());
    home.write("calibration.json", record.to_string());
    let config = std::fs::read_to_string(calibrated.path("calibrated/trifacet.toml")).unwrap();
    let config = config.replace("[publishing]\nudp = []\n", "");
    let mut daemon = Daemon::start_in(&home, &config);
    daemon.client().through("some seconds", |frame| frame.sample_index >= 4000);
    let drift = &daemon.status()["calibration_drift"];
    assert!(drift.as_object().unwrap().values().all(Value::is_null), "{drift}");
    assert!(doubt(&daemon.status(), "calibration_drift").is_none());
}
