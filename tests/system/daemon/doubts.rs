//! Status of the frames for misleading light: a displaced laser, a step of the power, a burst of noise.

use trifacet_wire::Status;

use crate::testkit::{Daemon, Frame, truth};

/// The frames of the daemon up to this sample.
fn frames(daemon: &mut Daemon, last: u64) -> Vec<Frame> {
    let mut frames = daemon.client().through("the last", |f| f.sample_index >= last);
    frames.retain(Frame::of_samples);
    frames
}

#[test]
fn a_displaced_laser_contradicts_the_readback_until_it_returns() {
    let fault = "twin.fault = [{ at_s = 3, for_s = 1, kind = 'laser-bump', shift_um = [24, -18] }]";
    let mut daemon = Daemon::start(fault);
    let frames = frames(&mut daemon, 5500);
    assert!(frames.iter().any(|f| f.sample_index < 1500) && frames.iter().all(Frame::valid));
    for frame in &frames {
        // After the return, the mean of the residuals has to forget the displacement.
        if !(4000..4500).contains(&frame.sample_index) {
            let bumped = (3009..4000).contains(&frame.sample_index);
            assert_eq!(frame.has(Status::INCONSISTENT), bumped, "{frame:?}");
        }
        let residual_um = frame.steering_residual * 1e6;
        let expected = if (3000..4000).contains(&frame.sample_index) { 25.0..35.0 } else { 0.0..6.0 };
        assert!(expected.contains(&residual_um), "{frame:?}");
    }
    // The loop still returns the beam to the apex.
    assert!(frames.iter().any(|f| f.has(Status::INCONSISTENT) && f.locked()));
    daemon.message("contradict each other");
    daemon.message("agree again");
    daemon.read_log();
    let told = daemon.log.iter().filter(|line| line.to_string().contains("contradict each other")).count();
    assert_eq!(told, 1);
}

#[test]
fn samples_at_a_step_of_the_power_have_no_pose_and_the_others_have_one() {
    // 0.12 ms after the start of a scan, between two of its channels.
    let step = "twin.channel_skew_us = 50\n\
        twin.fault = [{ at_s = 2.00012, for_s = 0.5, kind = 'laser-power', factor = 1.2 }]";
    for average in [1, 10] {
        let mut daemon = Daemon::start(&format!("{step}\nestimation.average = {average}"));
        let frames = frames(&mut daemon, 3000);
        assert!(frames.iter().any(|f| f.sample_index < 1500));
        let mut beside = [0, 0];
        for frame in &frames {
            assert_eq!(frame.valid(), !frame.has(Status::POWER_STEP), "{frame:?}");
            if frame.has(Status::POWER_STEP) {
                let k = frame.sample_index;
                assert!([2000..2010, 2500..2510].iter().any(|range| range.contains(&k)), "{frame:?}");
                beside[usize::from(k >= 2500)] += 1;
            }
        }
        let expected = if average == 1 { 2..=4 } else { 1..=1 };
        assert!(beside.iter().all(|n| expected.contains(n)), "{beside:?}");
    }
}

#[test]
fn a_burst_of_noise_increases_the_standard_uncertainties() {
    let fault = "twin.fault = [{ at_s = 2, for_s = 1, kind = 'noise-burst', factor = 10 }]";
    let mut daemon = Daemon::start(fault);
    let frames = frames(&mut daemon, 3500);
    let truth = truth(fault, 3501);
    let (burst, calm): (Vec<Frame>, Vec<Frame>) = frames
        .into_iter()
        .filter(|f| !(2000..2020).contains(&f.sample_index))
        .partition(|f| (2020..3000).contains(&f.sample_index));
    let valid: Vec<_> = burst.iter().filter(|f| f.valid()).collect();
    assert!(valid.len() > burst.len() / 2, "{} of {}", valid.len(), burst.len());
    for frame in calm.iter().filter(|f| f.sample_index < 2000) {
        assert!(frame.deviations[0] < 1.2e-6, "{frame:?}");
    }
    assert!(valid.iter().all(|f| f.deviations[0] > 4e-6));
    for frame in burst.iter().chain(&calm).filter(|f| f.valid()) {
        for (axis, true_value) in truth[frame.sample_index as usize].iter().enumerate() {
            let error = (frame.pose[axis] - true_value) / f64::from(frame.deviations[axis]);
            assert!(error.abs() < 7.0, "{axis}: {error} sigma: {frame:?}");
        }
    }
}

/// 2.6 V of light at a threshold of 0.05 V: the powers change fast, but all of them are known.
#[test]
fn a_fast_vibration_makes_no_power_noisy_or_low() {
    let mut daemon = Daemon::start(
        "centering.mode = \"off\"\n\
         twin.motion = [{ axis = \"tx\", kind = \"sine\", amount_um = 20, frequency_hz = 400 }]",
    );
    assert!(frames(&mut daemon, 3000).iter().all(Frame::valid));
}

/// The noise of the powers is a quarter of them.
#[test]
fn powers_with_much_noise_are_noisy_and_not_low() {
    let mut daemon = Daemon::start("centering.mode = \"off\"\ntwin.power_noise = 0.25");
    let mut stream = daemon.client();
    stream.until("a noisy power", |f| f.has(Status::POWER_NOISY) && !f.valid());
    let low = [Status::PSD_A_LOW, Status::PSD_B_LOW, Status::PSD_C_LOW];
    assert!(
        stream.take(1000).iter().all(|f| f.has(Status::POWER_NOISY) || !low.iter().any(|bit| f.has(*bit)))
    );
}

/// A converter that samples one channel after the other refuses flicker only until its pattern is known.
#[test]
fn flicker_is_refused_until_it_is_known() {
    let fault = "twin.channel_skew_us = 20\n\
        twin.fault = [{ at_s = 2, kind = 'flicker', fraction = 0.05, frequency_hz = 100 }]";
    let mut daemon = Daemon::start(fault);
    let frames = frames(&mut daemon, 5000);
    let refused: Vec<_> = frames.iter().filter(|f| !f.valid()).map(|f| f.sample_index).collect();
    assert!(refused.iter().all(|k| (2000..2030).contains(k)), "{refused:?}");
    assert!(frames.iter().all(|f| f.valid() != f.has(Status::POWER_STEP)));
}
