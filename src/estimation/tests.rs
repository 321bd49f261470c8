//! Estimation as a whole: what its reports say about samples of light that is known.

use super::*;
use crate::acquisition::{PsdState, Sample};
use crate::centering::LoopState;
use crate::clock::Mono;
use crate::config::Config;
use crate::optics::{Model, Optics, Pose, Vec2};
use crate::publishing::stamp::tests::report;

fn estimation(text: &str, id: u32) -> Estimation {
    let config = crate::config::parse(text, None).unwrap();
    Estimation::new(Settings::new(&config, true, id).unwrap())
}

/// The light of the mirror at rest.
fn sample(index: u64) -> Sample {
    let optics = Optics::new(&Config::default().head.build().unwrap());
    let light = optics.trace(Model::Gaussian, &Pose::default(), Vec2::zeros()).unwrap();
    Sample {
        index,
        time: Mono(index as i64 * 1_000_000),
        time_sigma_ns: None,
        lost: 0,
        spots: light.spots,
        powers: light.powers.map(|fraction| fraction * 1e-3),
        psds: [PsdState::Good; 3],
        steering: None,
        output_railed: false,
    }
}

#[test]
fn only_the_pose_goes_to_the_users_frame() {
    let estimation = estimation("frames.tool.translation_mm = [0, 0, -40]", 5);
    let sensor = report();
    let user = estimation.in_user_frame(&sensor);
    let pose = user.pose.unwrap();
    assert!((pose.t.z + 0.04).abs() < 1e-5, "{pose:?}");
    // 40 mm below, a pitch of -5 urad is 0.2 um along x.
    assert!((pose.t.x - 1e-6 - 0.2e-6).abs() < 1e-11, "{pose:?}");
    let sd = user.covariance.unwrap()[(0, 0)].sqrt();
    assert!((sd - 2e-6 * 1.0016_f64.sqrt()).abs() < 1e-12, "{sd}");
    assert_eq!(PoseReport { pose: sensor.pose, covariance: sensor.covariance, ..user }, sensor);
}

#[test]
fn a_pose_that_has_no_angles_there_has_a_reason_instead() {
    let estimation = estimation("frames.base.rotation_deg = [0, 90, 0]", 5);
    let user = estimation.in_user_frame(&report());
    assert_eq!((user.pose, user.covariance), (None, None));
    assert!(user.status.has(Status::OUT_OF_RANGE) && !user.status.has(Status::POSE_VALID));
    let dark = PoseReport { pose: None, covariance: None, status: Status::PSD_A_LOW, ..report() };
    assert_eq!(estimation.in_user_frame(&dark), dark);
}

#[test]
fn a_block_has_samples_of_one_meaning_only() {
    let mut estimation = estimation("estimation.average = 4", 5);
    let steering = LoopState::default();
    let mut reports = Vec::new();
    for index in 0..12 {
        if index == 6 {
            let other = crate::config::parse("estimation.average = 4", None).unwrap();
            estimation.retune(Settings::new(&other, true, 6).unwrap());
        }
        reports.extend(estimation.sample(&sample(index), &steering));
    }
    let seen: Vec<_> = reports.iter().map(|r| (r.config, r.index, r.pose.is_some())).collect();
    assert_eq!(seen, [(5, 3, true), (6, 9, true)]);
}
