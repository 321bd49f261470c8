//! The test vectors of `firmware/vectors`, which a third program has written, hold for the codec, the emulator and the
//! session of the daemon, and for the firmware.

use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use trifacet::acquisition::SourceEvent;
use trifacet::acquisition::board::{Session, Settings};
use trifacet::config::Config;
use trifacet::core::telemetry::Counters;
use trifacet::core::time::Mono;
use trifacet::twin::Emulator;
use trifacet_wire::board::message::{ErrorReason, Reply, StartResult, SteerResult};
use trifacet_wire::board::{
    Answer, BoardIdentity, BoardScan, ChannelUnit, Deframer, Extension, MINOR, ScanFormat, Unit,
};
use trifacet_wire::channel::{Converter, MAX_CHANNELS, Role, SIGNALS};

use super::codec::{Question, answer, ask, compare, hex, receive, request};
use super::conversation::answers;

/// The entries of a file.
fn entries(text: &str) -> Vec<Value> {
    let entries: Vec<Value> = serde_json::from_str(text).unwrap();
    assert!(entries.len() >= 10);
    entries
}

fn text<'a>(entry: &'a Value, key: &str) -> &'a str {
    entry[key].as_str().unwrap_or_else(|| panic!("no {key} in {entry}"))
}

fn bytes(entry: &Value, key: &str) -> Vec<u8> {
    let digits = text(entry, key);
    (0..digits.len()).step_by(2).map(|k| u8::from_str_radix(&digits[k..k + 2], 16).unwrap()).collect()
}

/// A field of an entry as a number of any type.
fn number<T: TryFrom<i128>>(fields: &Value, key: &str) -> T {
    let number = fields[key].as_i64().map(i128::from).or(fields[key].as_u64().map(i128::from));
    let number = number.unwrap_or_else(|| panic!("no {key} in {fields}"));
    T::try_from(number).unwrap_or_else(|_| panic!("{key} in {fields}"))
}

#[test]
fn lines_contain_the_stated_messages() {
    let mut questions = Vec::new();
    for entry in entries(include_str!("../../../firmware/vectors/frames.json")) {
        let found = receive(&bytes(&entry, "line"));
        let messages: Vec<_> =
            entry["messages"].as_array().unwrap().iter().map(|message| message.as_str().unwrap()).collect();
        assert_eq!(found.expected, messages.join(" "), "{entry}");
        questions.push(found);
    }
    compare(&questions);
}

#[test]
fn requests_have_the_stated_meaning_or_error() {
    let mut questions = Vec::new();
    for entry in entries(include_str!("../../../firmware/vectors/requests.json")) {
        let found = request(&bytes(&entry, "message"), number(&entry, "minor"));
        let fields = &entry["request"];
        let list = |keys: &[&str]| -> String {
            let number = |key: &&str| match &fields[*key] {
                Value::Array(numbers) => numbers.iter().map(Value::to_string).collect::<Vec<_>>().join(" "),
                number => number.to_string(),
            };
            keys.iter().map(number).collect::<Vec<_>>().join(" ")
        };
        let expected = match fields["type"].as_str() {
            None => format!("error {}", entry["error"]),
            Some("identify") => format!("identify {}", list(&["minor"])),
            Some("start") => format!("start {}", list(&["rate", "park", "minor"])),
            Some("steer") => format!("steer {}", list(&["id", "codes", "lease", "on_expiry"])),
            Some(other) => other.into(),
        };
        assert_eq!(found.expected, expected, "{entry}");
        questions.push(found);
    }
    compare(&questions);
}

fn codes(fields: &Value) -> (u8, [i32; MAX_CHANNELS]) {
    let codes = fields["codes"].as_array().unwrap();
    let code = |k: usize| codes.get(k).map_or(0, |code| code.as_i64().unwrap() as i32);
    (codes.len() as u8, std::array::from_fn(code))
}

fn scan(fields: &Value, long: bool) -> BoardScan {
    let status: u8 = number(fields, "status");
    let (channels, codes) = codes(fields);
    let wide_tick = status & 16 != 0;
    BoardScan {
        format: if long { ScanFormat::Long { wide_tick } } else { ScanFormat::Short },
        sequence: number(fields, "sequence"),
        tick: number(fields, "tick"),
        applied: (long && status & 8 != 0).then(|| number(fields, "applied")),
        output_railed: status & 1 != 0,
        lease_expired: status & 2 != 0,
        overrun: status & 4 != 0,
        channels,
        codes,
    }
}

fn identity(fields: &Value) -> BoardIdentity {
    let flags: u8 = number(fields, "flags");
    let channels: Vec<(u8, u32)> = serde_json::from_value(fields["channels"].clone()).unwrap();
    let unit = |unit: &Value| ChannelUnit {
        channel: number(unit, "channel"),
        unit: Unit::of(number(unit, "unit")),
        scale: number(unit, "scale"),
        exponent: number(unit, "exponent"),
        zero: number(unit, "zero"),
    };
    BoardIdentity {
        tick_hz: number(fields, "tick_hz"),
        converter: Converter {
            bits: number(fields, "converter_bits"),
            range_v: f64::from(number::<u32>(fields, "range")) * 1e-3,
        },
        output_bits: number(fields, "output_bits"),
        simulated: flags & 1 != 0,
        rate_mhz: [number(fields, "slowest"), number(fields, "fastest")],
        roles: channels.iter().map(|(role, _)| Role::of(*role)).collect(),
        skew_ns: channels.iter().map(|(_, skew)| *skew).collect(),
        name: text(fields, "name").into(),
        extensible: flags & 2 != 0,
        extension: fields["units"].as_array().map(|units| Extension {
            minor: number(fields, "minor"),
            wide_tick: number::<u8>(fields, "tick_bits") == 64,
            boot_id: number(fields, "boot_id"),
            units: units.iter().map(unit).collect(),
        }),
    }
}

fn described(entry: &Value) -> Answer {
    let fields = &entry["fields"];
    let result: usize = fields["result"].as_u64().unwrap_or(0) as usize;
    match text(entry, "type") {
        "identity" => Answer::Identity(identity(fields)),
        "reply" => Answer::Reply(Reply {
            start: number::<u8>(fields, "request") == 2,
            result: [StartResult::Done, StartResult::RateOutOfRange, StartResult::ParkOutOfRange][result],
            rate_mhz: number(fields, "rate"),
        }),
        "ack" => Answer::Ack {
            id: number(fields, "id"),
            result: [SteerResult::Accepted, SteerResult::OutOfRange, SteerResult::NotStarted][result],
        },
        "error" => Answer::Error {
            reason: [
                ErrorReason::Corrupted,
                ErrorReason::Type,
                ErrorReason::Version,
                ErrorReason::Length,
                ErrorReason::Value,
            ][number::<usize>(fields, "reason") - 1],
            kind: number(fields, "type"),
        },
        name => Answer::Scan(scan(fields, name == "long_scan")),
    }
}

#[test]
fn answers_have_the_stated_frames() {
    let mut questions = Vec::new();
    for entry in entries(include_str!("../../../firmware/vectors/answers.json")) {
        let (stated, frame) = (described(&entry), bytes(&entry, "frame"));
        let message = Deframer::default().next(&mut &frame[..]).unwrap().unwrap().to_vec();
        assert_eq!(Answer::decode(&message).as_ref(), Ok(&stated), "{entry}");
        let found = answer(&stated);
        assert_eq!(found.expected, hex(&frame), "{entry}");
        // The host of a plain identity states no version; the board may speak 1.1 all the same.
        questions.push(found);
    }
    compare(&questions);
}

/// The steps of a conversation with the emulator, and the same questions to the firmware.
fn converse(entry: &Value, questions: &mut Vec<Question>) {
    let minor = entry["minor"].as_u64().unwrap_or(MINOR.into()) as u8;
    let mut board = Emulator::new(&Config::default(), Mono(0)).unwrap().with_minor(minor);
    questions.push(Question { line: format!("power_up {minor}"), expected: String::new() });
    for step in entry["steps"].as_array().unwrap() {
        let at = Mono(number::<i64>(step, "at_ms") * 1_000_000);
        let line = bytes(step, "receive");
        board.sample(at);
        board.received(&line, at);
        let state = board.state();
        let [x, y] = state.output_codes;
        let found = format!("{} {x} {y} {}", answers(&mut board), u8::from(state.lease_expired));
        let outputs = &step["outputs"];
        let expired = u8::from(step["lease_expired"] == true);
        let expected = format!("{} {} {} {expired}", text(step, "answers"), outputs[0], outputs[1]);
        assert_eq!(found, expected, "{}: {step}", entry["name"]);
        questions.push(Question { line: format!("board {} {}", at.0 / 1000, hex(&line)), expected });
    }
}

/// All messages on a line; every frame must be whole.
fn all_answers(mut line: &[u8]) -> Vec<Answer> {
    let (mut deframer, mut found) = (Deframer::default(), Vec::new());
    while let Some(message) = deframer.next(&mut line) {
        found.push(Answer::decode(message.expect("a whole frame")).unwrap());
    }
    found
}

/// What a board sends after a STEER when its buffer was full: scans from number 0 without a gap, fewer than were taken, and
/// then the acknowledgement.
fn check_full_buffer(line: &[u8], taken: usize, ack: &[u8]) {
    let mut found = all_answers(line);
    let last = found.pop().unwrap();
    assert_eq!(vec![last], all_answers(ack));
    assert!((1..taken).contains(&found.len()), "{} scans", found.len());
    for (k, answer) in found.iter().enumerate() {
        assert!(matches!(answer, Answer::Scan(scan) if scan.sequence as usize == k), "{k}: {answer:?}");
    }
}

fn fill_the_buffer(entry: &Value) {
    let taken: usize = number(entry, "scans");
    let mut board = Emulator::new(&Config::default(), Mono(0)).unwrap();
    board.received(&bytes(entry, "start"), Mono(0));
    answers(&mut board);
    for _ in 0..taken {
        board.sample(Mono(1_000_000));
    }
    board.received(&bytes(entry, "steer"), Mono(1_000_000));
    check_full_buffer(board.output(), taken, &bytes(entry, "ack"));
    board.written(board.output().len());
    board.sample(Mono(2_000_000));
    let next = all_answers(board.output());
    assert!(matches!(next[..], [Answer::Scan(scan)] if scan.sequence as usize == taken));

    let lines = [
        "power_up 1".into(),
        format!("board 0 {}", text(entry, "start")),
        format!("scans {taken}"),
        format!("board 1000 {}", text(entry, "steer")),
        "scans 1".into(),
        "board 2000 00".into(),
    ];
    let found = ask(&lines);
    let line_of =
        |answer: &str| bytes(&serde_json::json!({ "hex": answer.split(' ').next().unwrap() }), "hex");
    check_full_buffer(&line_of(&found[3]), taken, &bytes(entry, "ack"));
    let next = all_answers(&line_of(&found[5]));
    assert!(matches!(next[..], [Answer::Scan(scan)] if scan.sequence as usize == taken));
}

#[test]
fn conversations_have_the_stated_answers_and_outputs() {
    let mut questions = Vec::new();
    let entries = entries(include_str!("../../../firmware/vectors/conversations.json"));
    let (full, steps): (Vec<_>, Vec<_>) = entries.iter().partition(|entry| entry["steps"].is_null());
    for entry in steps {
        converse(entry, &mut questions);
    }
    compare(&questions);
    assert_eq!(full.len(), 1);
    fill_the_buffer(full[0]);
}

#[test]
fn a_host_counts_what_is_stated() {
    let board = BoardIdentity {
        tick_hz: 1_000_000,
        converter: Converter { bits: 18, range_v: 10.0 },
        output_bits: 16,
        simulated: false,
        rate_mhz: [1000, 20_000_000],
        roles: SIGNALS.to_vec(),
        skew_ns: vec![0; SIGNALS.len()],
        name: "vectors".into(),
        extensible: false,
        extension: None,
    };
    let reply = Reply { start: true, result: StartResult::Done, rate_mhz: 1_000_000 };
    for entry in entries(include_str!("../../../firmware/vectors/host.json")) {
        let counters = Arc::<Counters>::default();
        let silence = Duration::from_millis(20);
        let settings = Settings {
            rate_hz: 1000.0,
            baud: Some(921_600),
            latency_ns: 0,
            silence,
            park: [0.0; 2],
            most_in_flight: 5,
        };
        let mut session = Session::new(settings, Arc::clone(&counters));
        let mut now = Mono(1_000_000_000);
        session.connected(now);
        for answer in [Answer::Identity(board.clone()), Answer::Reply(reply)] {
            let mut line = Vec::new();
            answer.encode(&mut line);
            session.received(&line, now);
        }
        for line in entry["lines"].as_array().unwrap() {
            now = now + 1_000_000;
            session.received(&bytes(&serde_json::json!({ "line": line }), "line"), now);
        }
        let events = std::iter::from_fn(|| session.event());
        let scans = events.filter(|event| matches!(event, SourceEvent::Scan(_))).count() as u64;
        let found = serde_json::json!({
            "scans": scans,
            "lost": counters.scans_lost.get(),
            "repeated": counters.scans_repeated.get(),
            "late": counters.scans_late.get(),
            "corrupted": counters.frames_corrupted.get(),
            "unknown": counters.frames_unknown.get(),
            "board_errors": counters.board_errors.get(),
            "overruns": counters.converter_overruns.get(),
            "leases_expired": counters.leases_expired.get(),
            "clock_faults": counters.clock_faults.get(),
        });
        assert_eq!(found, entry["expected"], "{}", entry["name"]);
    }
}
