//! The twin as a whole: its codes against its true state.

use super::*;
use crate::config::{Fault, Motion};

/// A mirror at rest under a centred beam.
fn quiet() -> Config {
    let mut config = Config::default();
    config.twin.motion = Vec::<Motion>::new();
    config
}

fn scans(config: &Config, n: usize) -> Vec<TwinScan> {
    let mut twin = Twin::new(config).unwrap();
    (0..n).map(|_| twin.next_scan()).collect()
}

fn volts(scan: &TwinScan, channel: usize) -> f64 {
    f64::from(scan.codes[channel]) * 10.0 / f64::from(1 << 17)
}

fn mean_and_sd(x: &[f64]) -> (f64, f64) {
    let n = x.len() as f64;
    let mean = x.iter().sum::<f64>() / n;
    (mean, (x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
}

#[test]
fn the_same_seed_gives_the_same_scans_and_another_seed_does_not() {
    let mut config = Config::default();
    let first = scans(&config, 500);
    assert_eq!(first, scans(&config, 500));
    config.twin.seed = 2;
    assert_ne!(first[499].codes, scans(&config, 500)[499].codes);
}

#[test]
fn scans_come_at_index_over_rate() {
    let mut config = quiet();
    config.acquisition.rate_hz = 3000.0;
    for (k, scan) in scans(&config, 100).iter().enumerate() {
        assert_eq!((scan.index, scan.t_s), (k as u64, k as f64 / 3000.0));
    }
}

#[test]
fn the_noise_is_that_of_the_configuration() {
    let n = 20_000;
    let scans = scans(&quiet(), n);
    let light = scans[0].truth.spots.map(Option::unwrap);
    let check = |channel: usize, scale: f64, mean: f64, sd: f64| {
        let x: Vec<f64> = scans.iter().map(|s| volts(s, channel) * scale).collect();
        let (m, s) = mean_and_sd(&x);
        let root = (n as f64).sqrt();
        assert!((m - mean).abs() < 4.0 * sd / root, "channel {channel}: mean {m}, not {mean}");
        assert!((s / sd - 1.0).abs() < 4.0 / (root * 2_f64.sqrt()), "channel {channel}: sd {s}, not {sd}");
    };
    for (psd, spot) in light.iter().enumerate() {
        for axis in 0..2 {
            check(3 * psd + axis, 6.5e-3 / 10.0, spot.at[axis], 1.08e-6);
        }
        let power_mw = 0.6 * spot.power;
        check(3 * psd + 2, 0.0667, power_mw, 1e-3 * power_mw);
    }
    check(9, 50e-6, 0.0, 0.1e-6);
    check(10, 50e-6, 0.0, 0.1e-6);
}

#[test]
fn faults_change_only_their_channels_and_not_the_later_noise() {
    let plain = scans(&quiet(), 300);
    let rail = (1 << 17) - 1;
    let faulty = |kind: FaultKind| {
        let mut config = quiet();
        config.twin.fault = vec![Fault { at_s: 0.1, for_s: Some(0.1), kind }];
        let faulty = scans(&config, 300);
        assert!(faulty[..100].iter().zip(&plain).all(|(a, b)| a == b), "{kind:?} started early");
        assert!(faulty[200..].iter().zip(&plain[200..]).all(|(a, b)| a == b), "{kind:?} left a trace");
        faulty[100..200].to_vec()
    };
    let changed = |scans: &[TwinScan]| -> Vec<usize> {
        (0..11).filter(|&c| scans.iter().zip(&plain[100..]).any(|(a, b)| a.codes[c] != b.codes[c])).collect()
    };
    let no_light = |s: &TwinScan, psd: usize| s.codes[3 * psd + 2] == 0 && volts(s, 3 * psd).abs() < 0.01;

    let blocked = faulty(FaultKind::BeamBlocked);
    assert!(blocked.iter().all(|s| (0..3).all(|psd| no_light(s, psd))));
    let dark = faulty(FaultKind::PsdDark { psd: 1 });
    assert!(dark.iter().all(|s| no_light(s, 1)));
    // With the beam centred, u of B is 0 with or without light; v and the sum are not.
    assert_eq!(changed(&dark).into_iter().filter(|c| !(3..6).contains(c)).count(), 0);
    let clipped = faulty(FaultKind::Clipped { channel: 7 });
    assert_eq!(changed(&clipped), [7]);
    assert!(clipped.iter().all(|s| s.codes[7] == rail));
    let dimmed = faulty(FaultKind::LaserPower { factor: 0.5 });
    assert_eq!(changed(&dimmed), [2, 5, 8]);
    assert!((volts(&dimmed[0], 2) / volts(&plain[100], 2) - 0.5).abs() < 1e-4);

    // Half as much light again, at the centre: the sums increase by a half, and the spots shrink by a third.
    let lit = faulty(FaultKind::AmbientLight { fraction: 0.5 });
    for psd in 0..3 {
        assert!((volts(&lit[0], 3 * psd + 2) / volts(&plain[100], 3 * psd + 2) - 1.5).abs() < 1e-2);
        assert!((volts(&lit[0], 3 * psd + 1) / volts(&plain[100], 3 * psd + 1) - 1.0 / 1.5).abs() < 0.02);
    }
    let stuck = faulty(FaultKind::ReadbackFrozen);
    assert!(stuck.iter().all(|s| s.codes[9..11] == plain[99].codes[9..11]));
    let loud = faulty(FaultKind::NoiseBurst { factor: 10.0 });
    assert_eq!(changed(&loud), [0, 1, 2, 3, 4, 5, 6, 7, 8]);
    let off = |scans: &[TwinScan]| mean_and_sd(&scans.iter().map(|s| volts(s, 0)).collect::<Vec<_>>()).1;
    assert!((off(&loud) / off(&plain[100..200]) - 10.0).abs() < 0.1);
    let bumped = faulty(FaultKind::LaserBump { shift_um: [30.0, -10.0] });
    assert_eq!(changed(&bumped), [0, 1, 2, 3, 4, 5, 6, 7, 8]);
    assert!(bumped.iter().all(|s| (s.truth.laser[0] - 30e-6).abs() < 1e-15));
    assert!(bumped.iter().all(|s| (s.truth.offset.y + 10e-6).abs() < 1e-15));

    let fates = |kind| faulty(kind).iter().map(|s| s.fate).collect::<Vec<_>>();
    let count = |fates: Vec<Fate>, fate| fates.iter().filter(|f| **f == fate).count();
    assert_eq!(count(fates(FaultKind::Stalled), Fate::Stalled), 100);
    let dropped = count(fates(FaultKind::Dropped { fraction: 0.3 }), Fate::Dropped);
    assert!((10..=50).contains(&dropped), "{dropped}");
    let corrupted = count(fates(FaultKind::Corrupted { fraction: 0.3 }), Fate::Corrupted);
    assert!((10..=50).contains(&corrupted), "{corrupted}");
    assert!(plain.iter().all(|s| s.fate == Fate::Sent));
}

#[test]
fn the_laser_follows_its_commands_and_the_readback_reports_it() {
    let mut config = quiet();
    config.twin.laser_offset_um = [20.0, 0.0];
    let mut twin = Twin::new(&config).unwrap();
    // 100 um and -50 um; 1 ms of delay and 0.5 ms of lag.
    twin.steer([6554, -3277], 0.0);
    for _ in 0..2 {
        let laser = twin.next_scan().truth.laser;
        assert!((laser[0] - 20e-6).abs() < 1e-18 && laser[1] == 0.0, "{laser:?}");
    }
    let after_two_lags = twin.next_scan().truth.laser;
    assert!((after_two_lags[0] - (20e-6 + 100e-6 * (1.0 - (-2_f64).exp()))).abs() < 1e-8);
    let last = (0..20).map(|_| twin.next_scan()).last().unwrap();
    assert!((last.truth.offset.x - 120e-6).abs() < 1e-8 && (last.truth.offset.y + 50e-6).abs() < 1e-8);
    assert!((volts(&last, 9) * 50.0 - 100.0).abs() < 1.0 && (volts(&last, 10) * 50.0 + 50.0).abs() < 1.0);
    assert!(!last.output_railed);
}

#[test]
fn a_stuck_stage_does_not_move_and_a_railed_one_reports_it() {
    let mut config = quiet();
    config.twin.steering.limit_um = 100.0;
    let mut twin = Twin::new(&config).unwrap();
    twin.inject(FaultKind::SteeringStuck, Some(0.05)).unwrap();
    twin.steer([20_000, 0], 0.0);
    let run: Vec<_> = (0..100).map(|_| twin.next_scan()).collect();
    assert!(run[..50].iter().all(|s| s.truth.laser == [0.0; 2] && !s.output_railed));
    assert!((run[99].truth.laser[0] - 100e-6).abs() < 1e-12 && run[99].output_railed);
}

#[test]
fn with_skew_each_channel_is_taken_at_its_own_time() {
    let mut config = Config::default();
    config.acquisition.rate_hz = 100.0;
    config.twin.channel_skew_us = 100.0;
    config.twin.spot_noise_um = 0.0;
    config.twin.motion = vec![Motion {
        axis: crate::config::Axis::Tz,
        amount_um: Some(100_000.0),
        amount_urad: None,
        kind: crate::config::MotionKind::Ramp,
        from_s: 0.0,
        until_s: Some(100.0),
        frequency_hz: None,
        high_hz: None,
        phase_deg: 0.0,
    }];
    let mut twin = Twin::new(&config).unwrap();
    assert_eq!(twin.identity().skew_ns[10], 1_000_000);
    let scan = twin.next_scan();
    // tz rises by 1 mm/s: 0.1 um from channel to channel. All v would otherwise read the same height.
    let v = |psd: usize| volts(&scan, 3 * psd + 1) * 650.0;
    assert!((v(1) - v(0) - 0.3).abs() < 0.06 && (v(2) - v(1) - 0.3).abs() < 0.06);
    config.acquisition.rate_hz = 1000.0;
    assert_eq!(Twin::new(&config).unwrap_err().key, "twin.channel_skew_us");
}

#[test]
fn with_skew_the_power_steps_within_a_scan() {
    let mut config = quiet();
    (config.twin.power_noise, config.twin.channel_skew_us) = (0.0, 10.0);
    // After the sum of B, before that of C; and between two scans.
    for (at_s, brighter) in [(0.010_06, [false, false, true]), (0.010_99, [false; 3])] {
        let kind = FaultKind::LaserPower { factor: 1.2 };
        config.twin.fault = vec![Fault { at_s, for_s: None, kind }];
        let scans = scans(&config, 12);
        let seen = |k: usize| [2, 5, 8].map(|c| volts(&scans[k], c) > 1.1 * volts(&scans[9], c));
        assert_eq!((seen(10), seen(11)), (brighter, [true; 3]));
    }
}

#[test]
fn flicker_changes_the_power_between_the_channels_of_a_scan() {
    let mut config = quiet();
    (config.twin.power_noise, config.twin.channel_skew_us) = (0.0, 10.0);
    let kind = FaultKind::Flicker { fraction: 0.1, frequency_hz: 1000.0 };
    let plain = scans(&config, 20);
    config.twin.fault = vec![Fault { at_s: 0.01, for_s: None, kind }];
    let flickering = scans(&config, 20);
    for k in 0..20 {
        for channel in [2, 5, 8] {
            let t_s = plain[k].t_s + 1e-5 * channel as f64;
            let sine = if k < 10 { 0.0 } else { (std::f64::consts::TAU * 1000.0 * t_s).sin() };
            let ratio = volts(&flickering[k], channel) / volts(&plain[k], channel);
            assert!((ratio - 1.0 - 0.1 * sine).abs() < 1e-3, "{k}, {channel}: {ratio}");
        }
    }
}

#[test]
fn without_readback_there_are_nine_channels() {
    let mut config = quiet();
    config.twin.steering.readback_noise_um = None;
    assert_eq!(Twin::new(&config).unwrap().identity().roles, SIGNALS);
}

#[test]
fn impossible_twins_are_refused_by_key() {
    let refused = |key: &str, change: &dyn Fn(&mut Config)| {
        let mut config = quiet();
        change(&mut config);
        assert_eq!(Twin::new(&config).unwrap_err().key, key);
    };
    for rate_hz in [0.0, -1.0, f64::NAN, 20_001.0] {
        refused("acquisition.rate_hz", &|c| c.acquisition.rate_hz = rate_hz);
    }
    refused("twin.converter_bits", &|c| c.twin.converter_bits = 33);
    refused("head", &|c| c.head.psd_distance_mm = 0.0);
    refused("twin.motion[0].amount_um", &|c| {
        c.twin.motion = Config::default().twin.motion;
        c.twin.motion[0].amount_um = None;
    });
}

#[test]
fn a_warming_head_drifts_and_its_temperature_is_one_more_channel() {
    let mut config = quiet();
    (config.twin.spot_noise_um, config.twin.converter_bits) = (0.0, 24);
    config.twin.fault = vec![Fault { at_s: 0.05, for_s: None, kind: FaultKind::ReadbackFrozen }];
    let cold = scans(&config, 100);
    config.twin.temperature =
        Some(crate::config::TwinTemperature { warm_up_k: 2.0, warm_up_s: 0.01, ..Default::default() });
    let twin = Twin::new(&config).unwrap();
    assert_eq!(twin.identity().roles[11], Role::Auxiliary);
    let warm = scans(&config, 100);
    let volts = |scan: &TwinScan, channel: usize| f64::from(scan.codes[channel]) * 10.0 / f64::from(1 << 23);
    assert!((volts(&warm[99], 11) - 0.2).abs() < 1e-4);
    assert_eq!(warm[0].codes[11], 0);
    assert_eq!(warm[60].codes[9], warm[99].codes[9], "the readback is frozen, the temperature is not");
    assert_eq!(cold[0].codes[..9], warm[0].codes[..9]);
    // At 2 K, each coordinate drifts by 1 um; the tilt of the light by 2 urad and the height of the PSDs by 2.4 um add to it.
    for channel in [0, 1, 3, 4, 6, 7] {
        let drift_um = (volts(&warm[99], channel) - volts(&cold[99], channel)) * 650.0;
        assert!((0.2..5.0).contains(&drift_um.abs()), "{channel}: {drift_um}");
    }
}

#[test]
fn a_head_of_its_own_does_not_follow_what_the_estimator_believes() {
    let mut config = quiet();
    config.twin.tolerances = Some(crate::config::TwinTolerances::default());
    let before = scans(&config, 50);
    assert!(Twin::new(&config).unwrap().identity().name.contains("a head of its own, seed 1"));
    // What a calibration writes.
    config.head.beam_diameter_mm = 0.5;
    config.head.psd_distance_mm = 249.0;
    config.head.a.psd_origin_mm = Some([249.5, 0.3, 0.1]);
    config.channels.b.gain = [1.0, 1.0, 1.03];
    config.frames.base.rotation_deg = [1.0, 0.0, 0.0];
    assert_eq!(before, scans(&config, 50));
    config.twin.psd = Some(crate::config::TwinPsds::default());
    assert_eq!(before, scans(&config, 50), "gains of one");
    config.twin.psd.as_mut().unwrap().b.gain = [1.0, 1.0, 1.03];
    assert_ne!(before, scans(&config, 50));
    config.twin.tolerances = None;
    let twin = |config: &Config| Twin::new(config).unwrap_err().to_string();
    config.twin.head = Some(crate::config::HeadConfig { psd_distance_mm: 250.0, ..Default::default() });
    config.twin.head.as_mut().unwrap().b.psd_origin_mm = Some([-125.0, 216.5, 20.0]);
    assert!(twin(&config).contains("light of facet B"), "{}", twin(&config));
}
