//! The loop: mode, setpoint, gains.

use serde_json::{Value, json};
use trifacet::exit;
use trifacet_wire::LockState;

use super::fixture::{AT_REST, Lab};

fn commands(status: &Value) -> u64 {
    status["counters"]["commands_sent"].as_u64().unwrap()
}

#[test]
fn in_shadow_mode_the_stage_does_not_move_and_the_commands_are_reported() {
    let daemon = Lab::start(&format!("[centering]\nmode = \"shadow\"\n{AT_REST}"));
    let status = daemon.status_until(|status| status["loop"]["shadow"].is_object());
    let x = |v: &Value| v[0].as_f64().unwrap();
    let offset = x(&status["loop"]["offset_um"]);
    assert!((offset + 100.0).abs() < 25.0, "the beam is 100 um short of the apex: {status}");
    let shadow = &status["loop"]["shadow"];
    let step = x(&shadow["would_go_to_um"]) - x(&shadow["stands_at_um"]);
    assert!((step + 0.2 * offset).abs() < 2.0, "{status}");
    for _ in 0..500 {
        let frame = daemon.frame();
        assert_eq!(frame.lock, LockState::Off);
        assert!(frame.steering[0].is_nan(), "not commanded: {frame:?}");
    }
    assert_eq!(commands(&daemon.told(&["status"])), 0);

    assert_eq!(daemon.told(&["loop", "on"])["loop"]["mode"], "on");
    let locked = daemon.frame_with(|frame| frame.lock == LockState::Locked);
    assert!((locked.steering[0] - 100e-6).abs() < 5e-6, "{locked:?}");

    daemon.told(&["loop", "off"]);
    let sent = commands(&daemon.told(&["status"]));
    daemon.frame_with(|frame| frame.lock == LockState::Off);
    // The stage keeps its position: the beam is still on the apex.
    let mut worst = 0.0_f32;
    for _ in 0..500 {
        let frame = daemon.frame();
        assert_eq!(frame.lock, LockState::Off);
        worst = worst.max(frame.beam_offset[0].abs());
    }
    assert!(worst < 10e-6, "{worst}");
    assert_eq!(commands(&daemon.told(&["status"])), sent);
}

#[test]
fn the_beam_goes_to_a_setpoint() {
    let daemon = Lab::start(AT_REST);
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
    let answer = daemon.told(&["setpoint", "-20", "10.5"]);
    assert_eq!(answer["loop"]["setpoint_um"], json!([-20.0, 10.5]));
    let there = |x: f32| (f64::from(x) + 20e-6).abs() < 3e-6;
    daemon.frame_with(|frame| there(frame.beam_offset[0]) && frame.lock == LockState::Locked);
    let sum =
        |axis: usize| (0..200).map(|_| f64::from(daemon.frame().beam_offset[axis])).sum::<f64>() / 200.0;
    let (x, y) = (sum(0), sum(1));
    assert!((x + 20e-6).abs() < 1e-6 && (y - 10.5e-6).abs() < 1e-6, "{x} {y}");
    let (code, _, errors) = daemon.ctl(&["setpoint", "0", "100.5"]);
    assert_eq!(code, i32::from(exit::USAGE));
    assert!(errors.contains("setpoint_um[1] = 100.5: allowed is -100 to 100"), "{errors}");
    assert_eq!(daemon.told(&["status"])["loop"]["setpoint_um"], json!([-20.0, 10.5]));
}

#[test]
fn gains_change_while_locked() {
    let daemon = Lab::start(AT_REST);
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
    daemon.frame_with(|frame| frame.lock == LockState::Locked);
    let answer = daemon.told(&["gains", "0.05", "50"]);
    assert_eq!((&answer["loop"]["kp"], &answer["loop"]["ki_per_s"]), (&json!(0.05), &json!(50.0)));
    for _ in 0..300 {
        let frame = daemon.frame();
        assert_eq!(frame.lock, LockState::Locked, "{frame:?}");
    }
    for bad in [["-0.1", "50"], ["0.1", "1e9"], ["11", "50"]] {
        let (code, _, errors) = daemon.ctl(&["gains", bad[0], bad[1]]);
        assert_eq!(code, i32::from(exit::USAGE), "{bad:?}");
        assert!(errors.contains("allowed is 0 to"), "{errors}");
    }
    let (_, _, errors) = daemon.ctl(&["gains", "0.1", "3000"]);
    assert!(errors.contains("the loop is not stable") && errors.contains("ki_per_s = 200"), "{errors}");
    assert_eq!(daemon.told(&["status"])["loop"]["kp"], 0.05);
}

#[test]
fn a_search_that_starts_is_answered_so() {
    let dark = "[[twin.fault]]\nat_s = 0\nkind = \"beam-blocked\"\n";
    let short = "[centering]\nsearch_attempts = 1\n[steering]\nlimit_um = 40\n";
    let daemon = Lab::start(&format!("{short}{AT_REST}{dark}"));
    let given_up =
        |status: &Value| status["loop"]["searches_in_vain"] == 1 && status["loop"]["lock"] == "held";
    daemon.status_until(given_up);
    assert_eq!(daemon.told(&["search"])["search"], "started");
    daemon.frame_with(|frame| frame.lock == LockState::Searching);
    daemon.status_until(given_up);
}

#[test]
fn in_manual_mode_the_stage_moves_to_commanded_positions_and_parks() {
    let daemon = Lab::start(&format!("[steering]\npark_um = [30, -40]\n{AT_REST}"));
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
    let (code, _, errors) = daemon.ctl(&["move", "10", "0"]);
    assert_eq!(code, i32::from(exit::DATA));
    assert!(errors.contains("only while the loop is \"manual\""), "{errors}");

    // The change from locked to manual does not move the stage.
    assert_eq!(daemon.told(&["loop", "manual"])["loop"]["lock"], "manual");
    let stays = daemon.frame_with(|frame| frame.lock == LockState::Manual);
    assert!((stays.steering[0] - 100e-6).abs() < 2e-6, "{stays:?}");
    let near = |x: f32, y: f64| (f64::from(x) - y).abs() < 1e-6;
    daemon.told(&["move", "-75.5", "20"]);
    let moved = daemon.frame_with(|f| near(f.steering[0], -75.5e-6) && near(f.steering[1], 20e-6));
    assert_eq!(moved.lock, LockState::Manual);
    let (code, _, errors) = daemon.ctl(&["move", "0", "400.5"]);
    assert_eq!(code, i32::from(exit::USAGE));
    assert!(errors.contains("y_um = 400.5: allowed is -400 to 400"), "{errors}");
    let (code, _, errors) = daemon.ctl(&["search"]);
    assert_eq!(code, i32::from(exit::DATA));
    assert!(errors.contains("only while it is \"on\""), "{errors}");

    daemon.told(&["loop", "on"]);
    daemon.frame_with(|frame| frame.lock == LockState::Locked);
    assert_eq!(daemon.told(&["park"])["loop"]["mode"], "manual");
    daemon.frame_with(|f| near(f.steering[0], 30e-6) && near(f.steering[1], -40e-6));
    daemon.told(&["loop", "on"]);
    daemon.frame_with(|frame| frame.lock == LockState::Locked);
    let answer = daemon.told(&["search"]);
    assert_eq!(answer["search"], "not started: the loop regulates, so there is nothing to search");
    assert_eq!(daemon.told(&["status"])["loop"]["lock"], "locked", "no search without a loss of the beam");
    let counters = &daemon.told(&["status"])["counters"];
    assert_eq!((&counters["lock_locked"], &counters["lock_released"]), (&json!(3), &json!(2)));
}
