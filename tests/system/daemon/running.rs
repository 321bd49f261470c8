//! The frames of a daemon on the twin, its start and its end.

use rustix::process::Signal;
use trifacet_wire::Status;

use crate::testkit::{Daemon, Frame, Stream, errors, mean, now_ns, truth};

#[test]
fn the_log_begins_with_version_file_and_config_id() {
    let mut daemon = Daemon::start("twin.seed = 7");
    let frame = daemon.client().take(1)[0];
    daemon.read_log();
    let first = &daemon.log[0];
    assert_eq!((&first["message"], &first["level"]), (&"trifacet starts".into(), &"INFO".into()), "{first}");
    assert_eq!(first["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(first["file"], daemon.file().to_str().unwrap());
    assert_eq!(first["config"], format!("{:08x}", frame.config));
}

#[test]
fn every_sample_becomes_a_frame_over_tcp_and_udp_with_a_true_pose() {
    let begin_ns = now_ns();
    let mut datagrams = Stream::udp();
    let mut daemon = Daemon::start(&format!("publishing.udp = [\"{}\"]", datagrams.local()));
    let mut stream = daemon.client();
    // Datagrams need no connection: they start with the first sample.
    let first = datagrams.take(1)[0];
    assert_eq!((first.sequence, first.sample_index), (0, 0));
    assert!(first.has(Status::NOT_LOCKED));
    let locked = stream.locked();
    let frames = stream.take(2000);
    let always = Status::POSE_VALID | Status::SIMULATED | Status::UNCALIBRATED | Status::STEERING_MEASURED;
    for frame in frames.iter().filter(|f| f.of_samples()) {
        assert_eq!(frame.status.0 & always.0, always.0, "{frame:?}");
        assert_eq!(
            frame.status.0 & !(always | Status::NOT_LOCKED | Status::CLOCK_UNSYNCED).0,
            0,
            "{frame:?}"
        );
    }
    let descriptor = stream.descriptor.clone().unwrap();
    assert_eq!((descriptor.session, descriptor.config), (locked.session, locked.config));
    assert_eq!((descriptor.rate_hz, descriptor.calibrated), (1000.0, false));
    let sent = datagrams.through("as far", |frame| frame.sequence == frames[1999].sequence);
    assert!(
        sent.iter().zip(0..).all(|(frame, k)| frame.sequence == k + 1),
        "TCP and UDP carry the same frames"
    );

    // The twin samples at k / rate from its start, so the times of the frames are known.
    assert!(first.time_ns > begin_ns && locked.arrived_ns < now_ns());
    for frame in sent.iter().filter(|f| f.of_samples()) {
        let due_ns = first.time_ns + frame.sample_index as i64 * 1_000_000;
        // The limit covers the slew of the offset to UTC during these seconds; there is no jitter.
        assert!((frame.time_ns - due_ns).abs() < 100_000, "{first:?} {frame:?}");
        assert!(frame.sent_ns() < frame.arrived_ns + 1_000_000, "{frame:?}");
    }

    let samples: Vec<_> = frames.into_iter().filter(Frame::of_samples).collect();
    let truth = truth("", samples.last().unwrap().sample_index as usize + 1);
    let (offset, scatter) = errors(&samples, &truth);
    for axis in 0..6 {
        let sd = f64::from(samples[0].deviations[axis]);
        assert!(offset[axis].abs() < 5.0 * sd / (samples.len() as f64).sqrt(), "{offset:?}");
        assert!(
            (0.9..1.1).contains(&scatter[axis]),
            "scatter in units of the reported standard uncertainties: {scatter:?}"
        );
    }
    let counters = stream.heartbeat().counters;
    assert_eq!((counters["scans_lost"], counters["tcp_overflows"], counters["udp_dropped"]), (0, 0, 0));
    daemon.ends_in_order(Signal::TERM);
    assert!(daemon.said("steering acknowledged its last command"), "{:#?}", daemon.log);
}

#[test]
fn averaged_frames_are_means_with_the_mean_time() {
    let mut daemon = Daemon::start("estimation.average = 10\ntwin.motion = []");
    let mut stream = daemon.client();
    stream.locked();
    let frames = stream.take(100);
    assert_eq!(stream.descriptor.clone().unwrap().rate_hz, 100.0);
    for pair in frames.windows(2).filter(|pair| pair.iter().all(Frame::of_samples)) {
        assert_eq!(pair[1].averaged, 10);
        assert_eq!(pair[1].sample_index, pair[0].sample_index + 10);
        assert!((pair[1].time_ns - pair[0].time_ns - 10_000_000).abs() < 20_000);
    }
    // The mean of ten times is 4.5 ms before the last of them; the fastest frame is sent soon after that.
    let quickest = frames.iter().filter(|f| f.of_samples()).map(|f| f.send_delay_ns).min().unwrap();
    assert!((4_500_000..6_500_000).contains(&quickest), "{quickest} ns");
    let sd = f64::from(frames[50].deviations[5]);
    assert!((0.6e-6..1.0e-6).contains(&sd), "2.5 urad divided by the root of ten: {sd}");
    daemon.ends_in_order(Signal::INT);
}

#[test]
fn the_ray_model_has_its_bias_and_no_beam_offset() {
    let mut daemon = Daemon::start("estimation.model = \"ray\"\ntwin.motion = []");
    let mut stream = daemon.client();
    stream.locked();
    stream.samples(200);
    let frames = stream.samples(500);
    assert_eq!(stream.descriptor.clone().unwrap().model, "ray");
    assert!(frames.iter().all(|f| f.beam_offset[0].is_nan() && f.steering_residual.is_nan()));
    let at = |axis: usize| mean(&frames, |f| f.pose[axis]) * 1e6;
    assert!((at(2) + 119.2).abs() < 1.0, "{} um", at(2));
    assert!(at(0).abs() < 1.0 && at(1).abs() < 1.0, "{} {} um", at(0), at(1));
    assert!((3..6).all(|axis| at(axis).abs() < 3.0), "{:?}", [at(3), at(4), at(5)]);
}

#[test]
fn datagrams_are_sent_without_tcp() {
    let mut datagrams = Stream::udp();
    let udp = datagrams.local();
    let mut daemon = Daemon::start(&format!("publishing.tcp = \"off\"\npublishing.udp = [\"{udp}\"]"));
    datagrams.take(500);
    daemon.ends_in_order(Signal::TERM);
    assert!(!daemon.said("listening"));
}

#[test]
fn at_10_khz_no_sample_is_lost() {
    let mut daemon = Daemon::start("acquisition.rate_hz = 10000\npublishing.tcp_queue = 65536");
    let mut stream = daemon.client();
    let first = stream.next().unwrap();
    let frames = stream.samples(25_000);
    let last = frames.last().unwrap();
    // The rules for every frame exclude gaps and losses. The last index belongs to its time only if late
    // samples were processed and not skipped.
    assert_eq!(last.sample_index, first.sample_index + 25_000);
    let passed_s = (last.time_ns - first.time_ns) as f64 * 1e-9;
    assert!((passed_s - 2.5).abs() < 0.0025, "{passed_s} s");
    assert_eq!(stream.lost, 0);
    let counters = stream.heartbeat().counters;
    assert_eq!((counters["scans_lost"], counters["estimation_overflows"]), (0, 0));
}

#[test]
fn a_port_in_use_and_an_invalid_configuration_have_their_own_exit_codes() {
    let mut first = Daemon::start("");
    let taken = first.address();
    let mut second = Daemon::start(&format!("publishing.tcp = \"{taken}\""));
    assert_eq!(second.end().code(), Some(75));
    assert!(second.said(&taken.to_string()) && second.said("another process has the port"));
    let mut wrong = Daemon::start("acquisition.rate = 5");
    assert_eq!(wrong.end().code(), Some(78));
    assert!(wrong.said("acquisition.rate is not a key") && wrong.said("rate_hz"), "{:?}", wrong.log);
    let mut missing = Daemon::start("channels.a.correction = \"nowhere.csv\"");
    assert_eq!(missing.end().code(), Some(78));
    assert!(missing.said("nowhere.csv"), "{:?}", missing.log);
    first.ends_in_order(Signal::TERM);
}
