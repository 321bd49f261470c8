//! `ctl self-check`: the beam moves over a small pattern, and returns.

use serde_json::{Value, json};
use trifacet::exit;
use trifacet_wire::Status;

use crate::testkit::{Daemon, Frame};

const AT_REST: &str = "twin.motion = []\n";

fn locked(config: &str) -> Daemon {
    let daemon = started(config);
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
    daemon
}

fn started(config: &str) -> Daemon {
    let mut daemon = Daemon::start(config);
    daemon.message("control socket is open");
    daemon
}

/// Exit code, answer and errors of the check. On a busy machine the loop does not always stay locked.
fn checked(daemon: &Daemon) -> (i32, Value, String) {
    for _ in 0..4 {
        let done = daemon.ctl(&["self-check"]);
        if !done.2.contains("stay locked") && !done.2.contains("is not locked") {
            return done;
        }
        daemon.status_until(|status| status["loop"]["lock"] == "locked");
    }
    daemon.ctl(&["self-check"])
}

/// The loop is where it was before the check.
fn is_back(daemon: &Daemon) {
    let offset = |status: &Value| {
        let offset = &status["loop"]["offset_um"];
        offset[0].as_f64().unwrap().hypot(offset[1].as_f64().unwrap())
    };
    daemon.status_until(|status| status["loop"]["lock"] == "locked" && offset(status) < 8.0);
    assert_eq!(daemon.status()["loop"]["setpoint_um"], json!([0.0, 0.0]));
}

fn of<'a>(check: &'a Value, quantity: &str) -> &'a Value {
    check["dependences"].as_array().unwrap().iter().find(|each| each["of"] == quantity).unwrap()
}

#[test]
fn a_healthy_head_at_rest_has_no_dependence() {
    let mut daemon = locked(AT_REST);
    assert!(daemon.status()["self_check"].is_null());
    let mut stream = daemon.client();
    let (answer, frames) = std::thread::scope(|scope| {
        let frames = scope.spawn(|| stream.samples(3000));
        (checked(&daemon).1, frames.join().unwrap())
    });
    assert_eq!(answer["ok"], true, "{answer}");
    let check = &answer["self_check"];
    assert_eq!(check["verdict"], "ok", "{check}");
    for name in ["tz", "offset x"] {
        let sigma = of(check, name)["sigma"][0].as_f64().unwrap();
        assert!((1e-5..0.004).contains(&sigma), "{check}");
    }
    assert_eq!(daemon.status()["self_check"], *check);
    is_back(&daemon);
    let reached = frames.iter().map(|frame| frame.beam_offset[0]).fold(0.0_f32, f32::max);
    assert!((15e-6..30e-6).contains(&reached), "the beam has moved: {reached}");
    assert!(frames.iter().all(Frame::valid));
    assert!(!frames.iter().any(|frame| frame.has(Status::INCONSISTENT)));
}

#[test]
fn a_wrong_scale_of_the_stage_is_found_with_its_size() {
    let daemon = locked(&format!("{AT_REST}twin.steering.matrix = [[1.05, 0], [0, 1]]\n"));
    let (code, answer, errors) = checked(&daemon);
    assert_eq!(code, i32::from(exit::DATA), "{answer} {errors}");
    assert!(errors.contains("offset x +0.05") && errors.contains("steering.matrix"), "{errors}");
    let check = &daemon.status()["self_check"];
    assert_eq!(check["verdict"], "found", "{check}");
    let excess = of(check, "offset x")["excess"][0].as_f64().unwrap();
    assert!((excess - 0.05).abs() < 0.005, "{check}");
    is_back(&daemon);
}

#[test]
fn a_periodic_check_finds_a_wrong_scale_and_the_doubt_stands_until_a_check_finds_none() {
    let wrong = format!("{AT_REST}twin.steering.matrix = [[1.05, 0], [0, 1]]\n");
    let mut daemon = locked(&format!("{wrong}centering.self_check_s = 1\n"));
    let found = |status: &Value| {
        let all = status["doubts"].as_array().unwrap();
        all.iter().find(|doubt| doubt["subject"] == "self_check").cloned()
    };
    let status = daemon.status_until(|status| found(status).is_some());
    let text = found(&status).unwrap()["text"].as_str().unwrap().to_owned();
    assert!(text.contains("offset x +0.05") && text.contains("steering.matrix"), "{text}");
    assert_eq!(status["self_check"]["verdict"], "found", "{status}");
    // The estimator learns the right scale, and the next check agrees.
    daemon.reload(&format!("{wrong}centering.self_check_s = 1\nsteering.matrix = [[1.05, 0], [0, 1]]\n"));
    daemon.status_until(|status| found(status).is_none());
    daemon.ends_in_order(rustix::process::Signal::TERM);
    assert!(daemon.said("the pose does not depend on the beam position any more"), "{:?}", daemon.log);
}

#[test]
fn a_periodic_check_that_is_not_possible_is_logged_once() {
    let mut daemon = started(&format!("{AT_REST}centering.mode = 'off'\ncentering.self_check_s = 1\n"));
    daemon.message("periodic self-check: no self-check: the loop is not locked");
    assert!(daemon.status()["self_check"].is_null());
    daemon.reload(&format!("{AT_REST}centering.self_check_s = 1\n"));
    daemon.status_until(|status| status["self_check"]["verdict"] == "ok");
    daemon.message("periodic self-check: it has a result again");
}

#[test]
fn an_interval_that_is_shorter_than_the_check_is_refused() {
    let refused = trifacet::config::parse("centering.self_check_s = 0.5\n", None).unwrap_err().to_string();
    assert!(refused.contains("self_check_s") && refused.contains("1 to"), "{refused}");
}

#[test]
fn a_moving_mirror_gives_no_verdict() {
    let motion = "twin.motion = [{ axis = 'tz', kind = 'sine', amount_um = 40, frequency_hz = 0.7 }]\n";
    let daemon = locked(motion);
    let (code, _, errors) = checked(&daemon);
    assert_eq!(code, i32::from(exit::IN_USE), "{errors}");
    assert!(errors.contains("not at rest"), "{errors}");
    assert_eq!(daemon.status()["self_check"]["verdict"], "unclear");
    is_back(&daemon);
}

#[test]
fn light_that_fails_during_the_check_ends_it_and_the_setpoint_returns() {
    let fault = "twin.fault = [{ at_s = 4, for_s = 8, kind = 'beam-blocked' }]\n";
    let daemon = locked(&format!("{AT_REST}{fault}"));
    let (code, _, errors) = daemon.ctl(&["self-check"]);
    assert_eq!(code, i32::from(exit::IN_USE), "{errors}");
    assert!(errors.contains("has no result"), "{errors}");
    assert!(daemon.status()["self_check"].is_null());
    is_back(&daemon);
}

#[test]
fn without_a_lock_a_readback_or_room_there_is_no_check() {
    for (config, why) in [
        ("centering.mode = 'off'\n", "the loop is not locked"),
        ("twin.steering.readback_noise_um = 'off'\n", "no readback"),
        ("steering.limit_um = 30\n", "too near to its limit"),
    ] {
        let daemon = started(&format!("{AT_REST}{config}"));
        let ready = if config.contains("off'") && config.contains("mode") { "off" } else { "locked" };
        daemon.status_until(|status| status["loop"]["lock"] == ready && status["pose"]["valid"] == true);
        let (code, _, errors) = daemon.ctl(&["self-check"]);
        assert_eq!(code, i32::from(exit::UNAVAILABLE), "{errors}");
        assert!(errors.contains(why), "{errors}");
    }
}
