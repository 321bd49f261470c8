//! `ctl twin-pose`: the mirror of the twin moves by command.

use std::io::{BufRead, Write};

use trifacet::exit;
use trifacet_wire::Status;

use super::fixture::{AT_REST, Lab};

#[test]
fn the_mirror_moves_there_while_the_loop_follows_and_its_motion_ends() {
    let daemon = Lab::start(AT_REST);
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
    for (words, pose) in [
        (["150", "-120", "80", "-1000", "500", "2000"], [150e-6, -120e-6, 80e-6, -1e-3, 5e-4, 2e-3]),
        (["0", "0", "0", "0", "0", "0"], [0.0; 6]),
    ] {
        let mut command = vec!["twin-pose"];
        command.extend(words);
        command.extend(["--over-s", "0.5"]);
        let answer = daemon.told(&command);
        assert_eq!(answer["twin_pose"]["tx_ty_tz_m"].as_array().unwrap().len(), 3, "{answer}");
        // The answer comes when the mirror is there.
        let sent = daemon.told(&["status"])["pose"]["sample_index"].as_u64().unwrap();
        let mut mean = [0.0; 6];
        for _ in 0..100 {
            let frame =
                daemon.frame_with(|frame| frame.sample_index > sent && frame.status.has(Status::POSE_VALID));
            for (mean, x) in mean.iter_mut().zip(frame.pose) {
                *mean += x / 100.0;
            }
        }
        for (axis, (found, expected)) in mean.iter().zip(pose).enumerate() {
            assert!((found - expected).abs() < 1e-6, "axis {axis}: {found:e} at {expected:e}");
        }
    }
}

#[test]
fn a_newer_move_replaces_an_older_one_and_bad_values_are_refused() {
    let daemon = Lab::start(AT_REST);
    let (code, _, errors) = daemon.ctl(&["twin-pose", "0", "0", "10001", "0", "0", "0"]);
    assert_eq!(code, i32::from(exit::USAGE), "{errors}");
    assert!(errors.contains("tz_um = 10001: allowed is -10000 to 10000"), "{errors}");
    let (code, _, errors) = daemon.ctl(&["twin-pose", "0", "0", "0", "0", "0", "0", "--over-s", "61"]);
    assert_eq!(code, i32::from(exit::USAGE), "{errors}");
    assert!(errors.contains("over_s = 61: allowed is 0 to 60"), "{errors}");
    // On a connection of its own, because `ctl` waits for the answer.
    let (mut answers, mut orders) = daemon.connect();
    writeln!(orders, "twin-pose 50 0 0 0 0 0 over_s=60").unwrap();
    let replaced = std::thread::spawn(move || {
        let mut answer = String::new();
        answers.read_line(&mut answer).unwrap();
        answer
    });
    while !replaced.is_finished() {
        daemon.told(&["twin-pose", "10", "0", "0", "0", "0", "0", "--over-s", "0"]);
    }
    let answer = replaced.join().unwrap();
    assert!(answer.contains("another twin-pose moved the mirror"), "{answer}");
}
