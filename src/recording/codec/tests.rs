use nalgebra::Matrix6;
use proptest::prelude::*;
use trifacet_core::centering::LoopState;
use trifacet_core::estimation::{Estimation, PoseReport};
use trifacet_core::signals::{PsdState, Sample};
use trifacet_core::steering::StagePosition;
use trifacet_wire::channel::{Converter, Role, SIGNALS};
use trifacet_wire::{LockState, PoseFrame};

use super::*;
use crate::config::{CalibrationState, RecordHeader};
use crate::recording::writer::Writer;

type Messages = Vec<(Topic, i64, Vec<u8>)>;

fn encoder() -> Encoder {
    Encoder::new((Mono(1_000), 1_700_000_000_000_000_000))
}

fn encode(encoder: &mut Encoder, entry: &Entry) -> Messages {
    let mut messages = Vec::new();
    let put = |message: Encoded<'_>| {
        messages.push((message.topic, message.time_ns, message.data.to_vec()));
        Ok::<_, EncodeError>(())
    };
    encoder.encode(entry, put).unwrap();
    messages
}

fn decode(decoder: &mut Decoder, messages: &Messages) -> Entry {
    let decoded = messages.iter().map(|(topic, _, data)| decoder.decode(*topic, data).unwrap());
    let entries: Vec<Entry> = decoded.flatten().collect();
    assert_eq!(entries.len(), 1);
    entries.into_iter().next().unwrap()
}

/// Encodes and decodes: checks for the same entry, and for the same bytes after encoding again.
fn survives(entry: &Entry) {
    let messages = encode(&mut encoder(), entry);
    let back = decode(&mut Decoder::default(), &messages);
    assert_eq!(format!("{back:?}"), format!("{entry:?}"));
    let again = encode(&mut encoder(), &back);
    assert_eq!(messages, again);
}

fn bits() -> impl Strategy<Value = f64> {
    any::<u64>().prop_map(f64::from_bits)
}

fn known() -> impl Strategy<Value = Option<[f64; 2]>> {
    prop::option::of(any::<[i32; 2]>().prop_map(|pair| pair.map(|x| f64::from(x) * 1.1e-15)))
}

prop_compose! {
    fn steering()(lock in 0..LockState::ALL.len(), position in known()) -> LoopState {
        LoopState { lock: LockState::ALL[lock], position: position.map(StagePosition) }
    }
}

prop_compose! {
    fn scan()(
        index: u64, time: i64, sigma in prop::option::of(0.0..1e9), lost: u32, codes: [i32; 16],
        output_railed: bool,
    ) -> Scan {
        Scan { index, time: Mono(time / 4), time_sigma_ns: sigma, lost, codes, output_railed, applied: None }
    }
}

prop_compose! {
    fn sample()(
        scan in scan(), spots in prop::array::uniform6(bits()), powers in prop::array::uniform3(bits()),
        psds in prop::array::uniform3(0..3_usize), read in known(), steering in steering(),
    ) -> Entry {
        let Scan { index, time, time_sigma_ns, lost, output_railed, .. } = scan;
        let psds = psds.map(|n| [PsdState::Good, PsdState::Low, PsdState::Clipped][n]);
        let sample =
            Sample { index, time, time_sigma_ns, lost, spots, powers, psds, steering: read, output_railed, applied: None, uncovered: false };
        Entry::Sample { scan, sample, steering }
    }
}

proptest! {
    #[test]
    fn samples_survive(entry in sample()) {
        survives(&entry);
    }

    #[test]
    fn frames_survive(body in prop::collection::vec(any::<u8>(), 180), lock in 0_u8..8, ahead: i32) {
        let mut bytes = PoseFrame::example().encode();
        bytes[8..188].copy_from_slice(&body);
        bytes[39] = 0x10; // a time of this century
        bytes[54] = lock;
        let crc = crc32fast::hash(&bytes[..188]);
        bytes[188..].copy_from_slice(&crc.to_le_bytes());
        let frame = PoseFrame::decode(&bytes).unwrap();
        let time = Mono(frame.time_ns / 2 + i64::from(ahead));
        let entry = Entry::Frame { frame, time, covariance: None };
        survives(&entry);
        let Entry::Frame { frame, .. } = decode(&mut Decoder::default(), &encode(&mut encoder(), &entry)) else {
            panic!("not a frame")
        };
        prop_assert_eq!(frame.encode(), bytes, "as transmitted");
    }

    #[test]
    fn silences_and_locks_survive(
        time: i32, steering in steering(), why in prop::option::of("[a-z\u{e4}\u{20ac}]{1,20}"), cause in ".{0,20}",
    ) {
        let time = Mono(i64::from(time));
        survives(&Entry::Silence { time, steering, why });
        survives(&Entry::Lock { time, before: steering.lock, after: LockState::Held, cause: cause.into() });
    }

    #[test]
    fn no_bytes_make_the_decoder_panic(data in prop::collection::vec(any::<u8>(), 0..300), plain: bool, topic in 0..9_usize) {
        let mut data = data;
        if plain {
            data.splice(..data.len().min(4), ENCAPSULATION);
        }
        // It may be valid or not: many byte sequences are valid samples.
        let _ = Decoder::default().decode(Topic::ALL[topic], &data);
    }
}

fn identity() -> Identity {
    Identity {
        name: "board 7 \u{b5}".into(),
        rate_hz: 10_000.5,
        converter: Converter { bits: 18, range_v: 10.24 },
        roles: SIGNALS.into_iter().chain([Role::Steering(0), Role::Steering(1), Role::Auxiliary]).collect(),
        skew_ns: (0..12).collect(),
        output_bits: 16,
        simulated: false,
    }
}

/// A keyframe of an estimation that has processed a few samples.
fn keyframe() -> Keyframe {
    let text = "estimation.average = 3\nmonitor.token = 'correct-horse-battery'\nmonitor.control = true";
    let config = parse(text, None).unwrap();
    let tables = Tables([None, Some(vec![0xff, 0, b'\n']), Some(b"u_m,v_m".to_vec())]);
    let mut estimation =
        Estimation::new(config.estimation_settings(&CalibrationState::default(), 3).unwrap());
    let mut last = None;
    for index in 0..40 {
        let noise = (index as f64).sin() * 1e-6;
        let sample = Sample {
            index,
            time: Mono(index as i64 * 100_000),
            time_sigma_ns: Some(0.1),
            lost: 0,
            spots: [noise, -noise, 1e-7, noise * 0.3, 0.0, -0.0],
            powers: [2e-4 + noise * 0.01; 3],
            psds: [PsdState::Good; 3],
            steering: Some([noise, 0.0]),
            output_railed: false,
            applied: None,
            uncovered: false,
        };
        estimation.sample(&sample, &LoopState::default());
        let codes = std::array::from_fn(|i| i as i32 - 5);
        last = Some(Scan {
            index,
            time: sample.time,
            time_sigma_ns: None,
            lost: 0,
            codes,
            output_railed: true,
            applied: None,
        });
    }
    let memory = estimation.memory().clone();
    Keyframe {
        context: Arc::new(CalibrationContext { config, tables, ..CalibrationContext::default() }),
        source: Some(Arc::new(identity())),
        last,
        memory,
    }
}

/// A state of version 0.1.0 ends before the mean residual and what was learnt of the powers.
#[test]
fn a_state_of_version_0_1_0_is_read() {
    let memory = keyframe().memory;
    assert!(memory.has_mean_residual());
    let whole = postcard::to_stdvec(&memory).unwrap();
    let without = postcard::to_stdvec(&memory.as_far_as(&EstimatorState::default())).unwrap();
    let end = whole.iter().zip(&without).position(|(a, b)| a != b).unwrap(); // the mark of the mean
    assert_eq!((whole[end], without[end]), (1, 0));
    let read: EstimatorState = postcard::from_bytes(&whole[..end]).unwrap();
    assert!(!read.has_mean_residual());
    assert_eq!(postcard::to_stdvec(&read).unwrap()[..=end], without[..=end]);
    let again: EstimatorState = postcard::from_bytes(&whole).unwrap();
    assert_eq!(format!("{again:?}"), format!("{memory:?}"));
}

#[test]
fn a_keyframe_survives_without_the_secret() {
    let keyframe = keyframe();
    let messages = encode(&mut encoder(), &Entry::Keyframe(Box::new(keyframe.clone())));
    let topics: Vec<Topic> = messages.iter().map(|m| m.0).collect();
    assert_eq!(topics, [Topic::Config, Topic::Source, Topic::Keyframe]);
    for (_, _, data) in &messages {
        assert!(!String::from_utf8_lossy(data).contains("correct-horse"), "the token is recorded");
    }
    let Entry::Keyframe(back) = decode(&mut Decoder::default(), &messages) else { panic!("no keyframe") };
    assert_eq!(format!("{:?}", back.memory), format!("{:?}", keyframe.memory));
    assert_eq!((back.last, &back.source), (keyframe.last, &keyframe.source));
    assert_eq!(back.context.tables, keyframe.context.tables);
    let mut public = keyframe.context.config.clone();
    (public.monitor.token, public.monitor.control) = (None, false);
    assert_eq!(back.context.config, public);
    assert_eq!(back.context.id(), keyframe.context.id());
}

/// A configuration of version 0.1.0 ends before the calibration: three tables counted as one.
#[test]
fn the_calibration_is_recorded_and_that_of_earlier_versions_is_known() {
    let record = RecordHeader {
        format: 1,
        version: "0.1.0".into(),
        date: "2026-05-04T12:00:00Z".into(),
        method: "stage".into(),
        fits: "00".into(),
        range_mm: 1.0,
        range_mrad: 5.0,
        std_um: [0.1; 3],
        std_urad: [0.3; 3],
        expires: None,
        at_calibration: None,
    };
    let calibration = CalibrationState { record: Some(record), standing: Standing::Expired, spread: None };
    let table = || Some(b"table".to_vec());
    for (first, standing) in [(table(), Standing::Valid), (None, Standing::Absent)] {
        let tables = Tables([first, table(), Some(b"the last one".to_vec())]);
        let (config, calibration) = (parse("", None).unwrap(), calibration.clone());
        let context = CalibrationContext { config, tables, calibration };
        let keyframe = Keyframe { context: Arc::new(context.clone()), ..keyframe() };
        let mut messages = encode(&mut encoder(), &Entry::Keyframe(Box::new(keyframe)));
        let Entry::Keyframe(back) = decode(&mut Decoder::default(), &messages) else { panic!("no keyframe") };
        assert_eq!(*back.context, context);
        let data = &mut messages[0].2;
        let end = data.windows(12).position(|bytes| bytes == b"the last one").unwrap() + 12;
        data.truncate(end);
        let Entry::Keyframe(back) = decode(&mut Decoder::default(), &messages) else { panic!("no keyframe") };
        assert_eq!(back.context.calibration, CalibrationState { record: None, standing, spread: None });
    }
}

#[test]
fn unchanged_parts_are_not_written_with_each_keyframe() {
    let mut encoder = encoder();
    let keyframe = keyframe();
    let entry = Entry::Keyframe(Box::new(keyframe.clone()));
    let mut decoder = Decoder::default();
    decode(&mut decoder, &encode(&mut encoder, &entry));
    let again = encode(&mut encoder, &entry);
    assert_eq!(again.len(), 1);
    let Entry::Keyframe(back) = decode(&mut decoder, &again) else { panic!("no keyframe") };
    assert_eq!(back.source, keyframe.source, "the earlier one is still in force");
    assert_eq!(decode_error(&mut Decoder::default(), &again), DecodeError::OutOfOrder.to_string());
    let other = Keyframe { source: Some(Arc::new(Identity { rate_hz: 5.0, ..identity() })), ..keyframe };
    assert_eq!(encode(&mut encoder, &Entry::Keyframe(Box::new(other))).len(), 2);
    encoder.restart();
    assert_eq!(encode(&mut encoder, &entry).len(), 3);
}

#[test]
fn parts_that_keyframes_depend_on_are_repeated_periodically() {
    let mut encoder = encoder();
    let entry = Entry::Keyframe(Box::new(keyframe()));
    let messages: Vec<usize> = (0..2 * AGAIN).map(|_| encode(&mut encoder, &entry).len()).collect();
    let (first, second) = messages.split_at(AGAIN as usize);
    assert_eq!(first, second);
    assert_eq!((first[0], &first[1..]), (3, &[1; AGAIN as usize - 1][..]));
}

fn decode_error(decoder: &mut Decoder, messages: &Messages) -> String {
    let (topic, _, data) = messages.last().unwrap();
    decoder.decode(*topic, data).unwrap_err().to_string()
}

#[test]
fn the_state_of_another_version_is_refused_and_its_context_is_known() {
    let mut messages = encode(&mut encoder(), &Entry::Keyframe(Box::new(keyframe())));
    let mut decoder = Decoder::default();
    let (_, _, keyframe) = messages.last_mut().unwrap();
    let at = keyframe.windows(VERSION.len()).position(|w| w == VERSION.as_bytes()).unwrap();
    keyframe[at] = b'9';
    for (topic, _, data) in &messages[..2] {
        decoder.decode(*topic, data).unwrap();
    }
    let error = decode_error(&mut decoder, &messages);
    assert!(error.contains(&format!("version 9{}", &VERSION[1..])) && error.contains(VERSION), "{error}");
    assert!(decoder.context().is_some() && decoder.source().is_some());
}

#[test]
fn times_are_those_of_the_frames() {
    let mut encoder = encoder();
    let steering = LoopState::default();
    let silence = |time| Entry::Silence { time: Mono(time), steering, why: None };
    assert_eq!(encode(&mut encoder, &silence(3_000))[0].1, 1_700_000_000_000_002_000);
    let frame = PoseFrame { time_ns: 1_800_000_000_000_000_000, ..PoseFrame::example() };
    let frame = Entry::Frame { frame, time: Mono(5_000), covariance: Some(Matrix6::identity()) };
    let messages = encode(&mut encoder, &frame);
    assert_eq!(
        messages.iter().map(|m| (m.0, m.1)).collect::<Vec<_>>(),
        [(Topic::Frame, 1_800_000_000_000_000_000), (Topic::Pose, 1_800_000_000_000_000_000),]
    );
    assert_eq!(encode(&mut encoder, &silence(6_000))[0].1, 1_800_000_000_000_001_000);
}

#[test]
fn a_file_is_readable_and_a_truncated_end_loses_one_chunk() {
    for compression in [None, Some(mcap::Compression::Lz4), Some(mcap::Compression::Zstd)] {
        let mut writer = Writer::new(Vec::new(), compression).unwrap();
        let mut encoder = encoder();
        let keyframe = Entry::Keyframe(Box::new(keyframe()));
        let frame = PoseFrame::example();
        let entries = (0..100).map(|n| Entry::Frame {
            frame: PoseFrame { sequence: n, ..frame },
            time: Mono(0),
            covariance: PoseReport::example().covariance,
        });
        for (n, entry) in [keyframe].into_iter().chain(entries).enumerate() {
            encoder.encode(&entry, |message| writer.put(message).map_err(Broken::from)).unwrap();
            if n == 50 {
                writer.flush().unwrap();
            }
        }
        let file = writer.finish().unwrap();
        let messages = mcap::MessageStream::new(&file).unwrap().map(Result::unwrap);
        let topics: Vec<_> = messages.map(|m| Topic::of(&m.channel.topic).unwrap()).collect();
        assert_eq!(topics.len(), 3 + 200);
        let chunks = mcap::Summary::read(&file).unwrap().unwrap().chunk_indexes;
        assert_eq!(chunks.len(), 2);
        let torn = &file[..chunks[1].chunk_start_offset as usize + 20];
        let options = mcap::read::Options::IgnoreEndMagic.into();
        let whole = mcap::MessageStream::new_with_options(torn, options).unwrap().map_while(Result::ok);
        assert_eq!(whole.count(), 3 + 100, "the first chunk");
    }
}

#[derive(Debug, thiserror::Error)]
enum Broken {
    #[error("{0}")]
    Encode(#[from] EncodeError),
    #[error("{0}")]
    File(#[from] mcap::McapError),
}
