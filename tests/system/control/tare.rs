//! Tare and frames.

use trifacet::exit;
use trifacet_wire::Status;

use super::fixture::{AT_REST, Lab};

/// Larger than the noise of a single pose, smaller than the pose that was tared.
const NOISE: f64 = 12e-6;

fn mean(daemon: &Lab, component: usize) -> f64 {
    (0..100).map(|_| daemon.frame_with(|f| f.status.has(Status::POSE_VALID)).pose[component]).sum::<f64>()
        / 100.0
}

#[test]
fn a_tare_sets_the_pose_to_zero_and_changes_the_config_id_of_the_frames() {
    let daemon = Lab::start(AT_REST);
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
    let before = daemon.frame();
    let answer = daemon.told(&["tare"]);
    assert_eq!((&answer["poses"], &answer["saved"]), (&100.into(), &false.into()), "{answer}");
    let mut tared = 0;
    while tared < 500 {
        let frame = daemon.frame();
        assert!(frame.status.has(Status::POSE_VALID), "{frame:?}");
        let (tx, yaw) = (frame.pose[0], frame.pose[5]);
        if frame.config == before.config {
            assert_eq!(tared, 0, "a frame with the old id after the tare");
            assert!((tx - 100e-6).abs() < NOISE && (yaw - 300e-6).abs() < 2.0 * NOISE, "{frame:?}");
        } else {
            assert!(tx.abs() < NOISE && yaw.abs() < 2.0 * NOISE, "{frame:?}");
            tared += 1;
        }
    }
    assert_eq!(answer["config"], format!("{:08x}", daemon.frame().config));
    assert!(!daemon.text().contains("frames"), "not saved");
    // A second tare, from more poses, replaces the first one: it is not applied to the remainder.
    let again = daemon.told(&["tare", "--poses", "400"]);
    let x = again["tare"]["translation_mm"][0].as_f64().unwrap();
    assert!((x - 0.1).abs() < 1e-3, "{again}");
    daemon.told(&["tare", "clear"]);
    let frame = daemon.frame_with(|frame| frame.config == before.config);
    assert!((frame.pose[0] - 100e-6).abs() < NOISE, "{frame:?}");
}

#[test]
fn a_saved_tare_survives_a_restart_and_keeps_the_rest_of_the_file() {
    let mut daemon =
        Lab::start(&format!("[frames.tool]\ntranslation_mm = [0.0, 0.0, -50.0] # below\n{AT_REST}"));
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
    let text = daemon.text();
    let answer = daemon.told(&["tare", "--save"]);
    assert_eq!(answer["saved"], true);
    let after = daemon.text();
    assert!(text.lines().all(|line| after.contains(line)), "{after}");
    assert!(after.contains("[frames.tare]\ntranslation_mm = ["), "{after}");
    let status = daemon.told(&["status"]);
    daemon.restart();
    let restarted = daemon.status_until(|status| status["pose"]["valid"] == true);
    assert_eq!(restarted["config"], status["config"], "the same frames of reference");
    assert_eq!(restarted["frames"], status["frames"]);
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
    let z = mean(&daemon, 2);
    assert!(z.abs() < 2e-6, "{z}");
    let cleared = daemon.told(&["tare", "clear", "--save"]);
    let text = daemon.text();
    assert!(text.contains("[frames.tare]\ntranslation_mm = [0.0, 0.0, 0.0]"), "{text}");
    let frame = daemon.frame_with(|frame| format!("{:08x}", frame.config) == cleared["config"]);
    assert!((frame.pose[2] + 50e-3).abs() < 10e-6, "{frame:?}");
}

#[test]
fn without_a_valid_pose_there_is_no_tare() {
    let daemon = Lab::start(&format!("{AT_REST}[[twin.fault]]\nat_s = 0\nkind = \"beam-blocked\"\n"));
    let before = daemon.frame_with(|frame| !frame.status.has(Status::SOURCE_DOWN));
    let (code, answer, errors) = daemon.ctl(&["tare", "--save"]);
    assert_eq!(code, i32::from(exit::DATA), "{answer}");
    assert!(errors.contains("PSD_A_LOW") && errors.contains("tare unchanged"), "{errors}");
    assert!(!daemon.text().contains("tare"));
    assert_eq!(daemon.frame().config, before.config);
    let (code, _, errors) = daemon.ctl(&["tare", "--poses", "10001"]);
    assert_eq!(code, i32::from(exit::USAGE));
    assert!(errors.contains("1 to 10000"), "{errors}");
}

#[test]
fn a_pitch_of_90_degrees_is_out_of_range_and_centering_continues() {
    let daemon = Lab::start(&format!("[frames.base]\nrotation_deg = [0.0, 90.0, 0.0]\n{AT_REST}"));
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
    let frame = daemon.frame_with(|frame| !frame.status.has(Status::NOT_LOCKED));
    assert!(frame.status.has(Status::OUT_OF_RANGE) && !frame.status.has(Status::POSE_VALID), "{frame:?}");
    assert!(frame.pose.iter().all(|x| x.is_nan()) && frame.deviations.iter().all(|x| x.is_nan()));
    let (code, _, errors) = daemon.ctl(&["tare"]);
    assert_eq!(code, i32::from(exit::DATA));
    assert!(errors.contains("90 degrees"), "{errors}");
}
