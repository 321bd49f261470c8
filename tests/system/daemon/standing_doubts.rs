//! Conditions that no single sample shows: a small constant contradiction, a power that has changed, ambient light.

use serde_json::Value;
use trifacet_wire::Status;

use crate::monitor::page::until;
use crate::testkit::http::get;
use crate::testkit::{Daemon, run, trifacet};

const ON: &str = "monitor.listen = \"127.0.0.1:0\"\n";

pub(super) fn doubt<'a>(from: &'a Value, subject: &str) -> Option<&'a Value> {
    from["doubts"].as_array().unwrap().iter().find(|doubt| doubt["subject"] == subject)
}

/// Waits until there is a doubt about this subject, and checks that every output shows it.
pub(super) fn stands(daemon: &mut Daemon, subject: &str, text: &str) {
    let at = daemon.monitor();
    let ready = until(at, subject, |ready| doubt(ready, subject).is_some());
    let shown = doubt(&ready, subject).unwrap();
    assert!(shown["text"].as_str().unwrap().contains(text), "{shown}");
    let status = daemon.status();
    assert_eq!(
        doubt(&status, subject).unwrap()["since"].as_str().unwrap().len(),
        "2026-01-01T00:00:00.000000000Z".len()
    );
    let line = daemon.message(text);
    assert_eq!((&line["level"], &line["doubt"]), (&"WARN".into(), &subject.into()), "{line}");
    let metrics = get(at, "/metrics").body;
    assert!(metrics.contains(&format!("trifacet_doubt{{subject=\"{subject}\"}} 1")), "{metrics}");
    let (config, endpoint) = (daemon.file(), format!("tcp://{}", daemon.address()));
    let status = run(trifacet(&["status", &endpoint, "--socket"]).arg(daemon.socket()));
    // The text is wrapped to the width of a terminal.
    let words = status.out.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words.contains("doubt since") && words.contains(text), "{}", status.out);
    let doctor = run(trifacet(&["doctor", &endpoint, "--config"]).arg(config));
    assert!(doctor.out.contains("doubt since") && doctor.out.contains(text), "{} {}", doctor.out, doctor.err);
}

/// Waits until there is no doubt about this subject.
fn is_over(daemon: &mut Daemon, subject: &str, text: &str) {
    let at = daemon.monitor();
    until(at, "over", |ready| doubt(ready, subject).is_none());
    let line = daemon.message(text);
    assert_eq!((&line["level"], &line["doubt"]), (&"INFO".into(), &subject.into()), "{line}");
    assert!(doubt(&daemon.status(), subject).is_none());
    let metrics = get(at, "/metrics").body;
    assert!(metrics.contains(&format!("trifacet_doubt{{subject=\"{subject}\"}} 0")), "{metrics}");
    daemon.read_log();
    let begun = |line: &&Value| line["level"] == "WARN" && line["doubt"] == subject;
    assert_eq!(daemon.log.iter().filter(begun).count(), 1, "one warning: {:#?}", daemon.log);
}

/// 6.5 um are within the limit of one residual.
#[test]
fn a_small_constant_contradiction_is_flagged_within_a_second_and_explained() {
    let fault = "twin.fault = [{ at_s = 2, for_s = 8, kind = 'laser-bump', shift_um = [6.5, 0] }]";
    let mut daemon = Daemon::start(&format!("{ON}{fault}"));
    let mut stream = daemon.client();
    let first = stream.until("flagged", |f| f.has(Status::INCONSISTENT));
    assert!(first.valid() && (2100..3000).contains(&first.sample_index), "{first:?}");
    stands(&mut daemon, "residual", "contradict each other constantly");
    let metrics = get(daemon.monitor(), "/metrics").body;
    let mean = |axis: &str| -> f64 {
        let name = format!("trifacet_steering_residual_mean_meters{{axis=\"{axis}\"}} ");
        metrics.lines().find_map(|line| line.strip_prefix(&name)).unwrap().parse().unwrap()
    };
    assert!((mean("x") * 1e6 + 6.5).abs() < 1.5 && mean("y").abs() < 0.5e-6, "{metrics}");
    is_over(&mut daemon, "residual", "agree again");
}

#[test]
fn a_power_that_differs_from_its_reference_is_doubted_and_its_poses_stay_usable() {
    let text = "laser.power_uw = 600\n\
                twin.fault = [{ at_s = 3, for_s = 8, kind = 'laser-power', factor = 0.93 }]";
    let mut daemon = Daemon::start(&format!("{ON}{text}"));
    let mut stream = daemon.client();
    stream.through("the first seconds", |frame| frame.sample_index >= 2500);
    assert!(doubt(&daemon.status(), "power").is_none());
    stands(&mut daemon, "power", "-7.0 % from laser.power_uw");
    assert!(stream.take(100).last().unwrap().status.usable(Status::SIMULATED));
    assert!(
        until(daemon.monitor(), "ready", |ready| ready["ready"] == true)["doubts"][0]["subject"] == "power"
    );
    is_over(&mut daemon, "power", "the total power is no longer doubted");
}

#[test]
fn without_a_reference_the_power_is_not_judged_and_a_reload_adds_one() {
    let fault = "twin.fault = [{ at_s = 0, kind = 'laser-power', factor = 0.9 }]\n";
    let mut daemon = Daemon::start(&format!("{ON}{fault}"));
    daemon.client().through("some seconds", |frame| frame.sample_index >= 3000);
    assert!(daemon.status()["doubts"].as_array().unwrap().is_empty());
    daemon.reload(&format!("{ON}{fault}laser.power_uw = 600\n"));
    stands(&mut daemon, "power", "-10.0 % from laser.power_uw");
    daemon.reload(&format!("{ON}{fault}laser = {{ power_uw = 600, power_tolerance = 0.2 }}\n"));
    is_over(&mut daemon, "power", "the total power is no longer doubted");
}

/// 30 mV on the sum of PSD B are 1 % of its usual 3 V.
#[test]
fn ambient_light_is_seen_while_the_beam_is_blocked_until_the_dark_offsets_include_it() {
    let twin = "[twin]\ndark_v = [0, 0, 0, 0, 0, 0.03, 0, 0, 0]\n\
                fault = [{ at_s = 2.5, for_s = 0.5, kind = 'beam-blocked' }]\n";
    let mut daemon = Daemon::start(&format!("{ON}{twin}"));
    stands(&mut daemon, "ambient_light", "A 0.00 %, B 1.00 %, C 0.00 %");
    let mut stream = daemon.client();
    stream.through("light again", |frame| frame.sample_index >= 4500);
    assert!(doubt(&daemon.status(), "ambient_light").is_some(), "it stands until the next darkness");
    daemon.reload(&format!("{ON}channels.b.dark_v = [0, 0, 0.03]\n{twin}"));
    is_over(&mut daemon, "ambient_light", "the readings without light are no longer doubted");
}

#[test]
fn a_blocked_beam_without_ambient_light_is_no_doubt() {
    let fault = "twin.fault = [{ at_s = 2.5, for_s = 0.5, kind = 'beam-blocked' }]";
    let mut daemon = Daemon::start(&format!("{ON}{fault}"));
    daemon.client().through("light again", |frame| frame.sample_index >= 4500);
    assert!(daemon.status()["doubts"].as_array().unwrap().is_empty());
}
