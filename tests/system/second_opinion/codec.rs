//! The codecs of `trifacet-wire` and of the firmware give the same results for the same input.

use std::fmt::Write as _;
use std::io::Write as _;
use std::process::{Command, Stdio};

use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trifacet_wire::actuator::LeaseAction;
use trifacet_wire::board::message::{ErrorReason, Reply, StartResult, SteerResult};
use trifacet_wire::board::{
    Answer, BoardIdentity, BoardScan, ChannelUnit, Deframer, Extension, MINOR, Request, ScanFormat, Unit,
    framing,
};
use trifacet_wire::channel::{Converter, MAX_CHANNELS, Role};

use super::board::Program;

const DOCUMENT: &str = include_str!("../../../docs/board-protocol.md");
/// Random inputs of each kind.
const INPUTS: usize = 4000;

/// A question to the codec in C, with the answer of the codec in Rust.
pub(super) struct Question {
    pub(super) line: String,
    pub(super) expected: String,
}

pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").unwrap();
        text
    })
}

/// The answers of the codec in C to these lines.
pub(super) fn ask(lines: &[String]) -> Vec<String> {
    let program = Program::compile("firmware/host/codec_host.c", &[]);
    let mut child =
        Command::new(program.path()).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut input = child.stdin.take().unwrap();
    let text: String = lines.iter().flat_map(|line| [line, "\n"]).collect();
    let writer = std::thread::spawn(move || input.write_all(text.as_bytes()).unwrap());
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap();
    let answers = String::from_utf8(output.stdout).unwrap();
    let answers: Vec<_> = answers.lines().map(|line| line.trim_end().to_owned()).collect();
    assert_eq!(answers.len(), lines.len(), "every question has an answer");
    answers
}

/// Asks all questions; the answers must be the expected ones.
pub(super) fn compare(questions: &[Question]) {
    let lines: Vec<_> = questions.iter().map(|question| question.line.clone()).collect();
    for (question, answer) in questions.iter().zip(ask(&lines)) {
        assert_eq!(answer, question.expected, "{}", question.line);
    }
}

/// Type of a message of boards on a network.
const BUSY: u8 = 0x87;

/// What the bytes of a line contain.
pub(super) fn receive(bytes: &[u8]) -> Question {
    let (mut deframer, mut rest, mut found) = (Deframer::default(), bytes, Vec::new());
    while let Some(message) = deframer.next(&mut rest) {
        found.push(message.map_or("damaged".into(), hex));
    }
    Question { line: format!("receive {}", hex(bytes)), expected: found.join(" ") }
}

/// What a message of the host means.
pub(super) fn request(message: &[u8], minor: u8) -> Question {
    let expected = match Request::decode(message, minor) {
        Ok(Request::Identify { minor }) => format!("identify {minor}"),
        Ok(Request::Stop) => "stop".into(),
        Ok(Request::Start { rate_mhz, park: [x, y], minor }) => format!("start {rate_mhz} {x} {y} {minor}"),
        Ok(Request::Steer(c)) => {
            let park = u8::from(c.on_expiry == LeaseAction::Park);
            format!("steer {} {} {} {} {park}", c.id, c.codes[0], c.codes[1], c.lease_ms)
        }
        Err(error) => match error.to_answer() {
            Answer::Error { reason, .. } => format!("error {}", reason as u8),
            other => panic!("{other:?}"),
        },
    };
    Question { line: format!("request {minor} {}", hex(message)), expected }
}

/// The frame of a message.
fn frame(message: &[u8]) -> Question {
    let mut out = Vec::new();
    framing::encode(message, &mut out);
    Question { line: format!("frame {}", hex(message)), expected: hex(&out) }
}

/// What the codec in C needs to know of version 1.1: host and board, width of the tick, boot id, units.
fn extension(id: &BoardIdentity) -> String {
    let Some(extension) = &id.extension else { return format!("0 {} 0 0 0", u8::from(id.extensible)) };
    let units = extension.units.iter().fold(String::new(), |mut all, unit| {
        let ChannelUnit { channel, unit, scale, exponent, zero } = unit;
        write!(all, " {channel} {} {scale} {exponent} {zero}", unit.number()).unwrap();
        all
    });
    let (wide, count) = (u8::from(extension.wide_tick), extension.units.len());
    format!("1 {} {wide} {} {count}{units}", extension.minor, extension.boot_id)
}

/// The frame of an answer of the board.
pub(super) fn answer(answer: &Answer) -> Question {
    let line = match answer {
        Answer::Identity(id) => {
            let channels: String =
                id.roles.iter().zip(&id.skew_ns).fold(String::new(), |mut all, (role, skew)| {
                    write!(all, " {} {skew}", role.number()).unwrap();
                    all
                });
            let (bits, range_mv) = (id.converter.bits, (id.converter.range_v * 1e3).round());
            format!(
                "identity {} {bits} {} {range_mv} {} {} {} {}{channels} {} {}",
                id.tick_hz,
                id.output_bits,
                id.rate_mhz[0],
                id.rate_mhz[1],
                u8::from(id.simulated),
                id.roles.len(),
                extension(id),
                id.name
            )
        }
        Answer::Reply(Reply { start, result, rate_mhz }) => {
            format!("reply {} {} {rate_mhz}", if *start { 2 } else { 3 }, *result as u8)
        }
        Answer::Ack { id, result } => format!("ack {id} {}", *result as u8),
        Answer::Scan(scan) => {
            let long = scan.format != ScanFormat::Short;
            let status = u8::from(scan.applied.is_some()) << 3
                | u8::from(scan.format.tick_bits() == 64) << 4
                | u8::from(scan.output_railed)
                | u8::from(scan.lease_expired) << 1
                | u8::from(scan.overrun) << 2;
            let codes: Vec<String> =
                scan.codes[..usize::from(scan.channels)].iter().map(i32::to_string).collect();
            let (name, applied) = if long {
                ("long_scan", format!(" {}", scan.applied.unwrap_or(0)))
            } else {
                ("scan", String::new())
            };
            let BoardScan { sequence, tick, channels, .. } = scan;
            format!("{name} {sequence} {tick} {status}{applied} {channels} {}", codes.join(" "))
        }
        Answer::Error { reason, kind } => format!("error {} {kind}", *reason as u8),
        Answer::Busy { .. } => panic!("only boards on a network send it: {answer:?}"),
    };
    let mut out = Vec::new();
    answer.encode(&mut out);
    Question { line, expected: hex(&out) }
}

fn bytes(random: &mut Pcg64Mcg, length: usize) -> Vec<u8> {
    let mut bytes = vec![0; length];
    random.fill_bytes(&mut bytes);
    // Zeros are the special bytes of the framing.
    let zeros = random.random_range(0..4_u8);
    bytes.iter_mut().filter(|byte| zeros > 0 && **byte % 8 < zeros).for_each(|byte| *byte = 0);
    bytes
}

#[test]
fn messages_have_the_same_frames() {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let messages = (0..INPUTS).map(|n| bytes(&mut random, 2 + n % (framing::MAX_MESSAGE - 5)));
    compare(&messages.map(|message| frame(&message)).collect::<Vec<_>>());
}

#[test]
fn intact_damaged_and_random_bytes_contain_the_same_messages() {
    let mut random = Pcg64Mcg::seed_from_u64(2);
    let mut questions = Vec::new();
    for n in 0..INPUTS {
        let mut line = bytes(&mut random, n % 40);
        for _ in 0..n % 4 {
            let length = random.random_range(2..=framing::MAX_MESSAGE - 4);
            framing::encode(&bytes(&mut random, length), &mut line);
        }
        if n % 3 == 0 && !line.is_empty() {
            let place = random.random_range(0..line.len());
            line[place] = random.random();
        }
        if n % 100 == 0 {
            line.extend(bytes(&mut random, 600)); // longer than any frame
        }
        line.push(0);
        questions.push(receive(&line));
    }
    assert!(questions.iter().any(|q| q.expected.contains("damaged")));
    assert!(questions.iter().any(|q| q.expected.split(' ').any(|word| word.len() > 400)));
    compare(&questions);
}

#[test]
fn requests_have_the_same_meaning_or_the_same_error() {
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let mut questions = Vec::new();
    for n in 0..INPUTS {
        // Types and lengths near those that exist.
        let length = [2, 14, 17, 3, 15, random.random_range(2..25)][n % 6];
        let mut message = bytes(&mut random, length);
        message[0] %= 6;
        message[1] = if n % 16 == 0 { message[1] } else { 1 };
        if n % 4 < 2 && [15, 17].contains(&length) {
            message[length - 1] %= 2;
        }
        questions.push(request(&message, (n % 5 > 1).into()));
    }
    for name in
        ["identify 0", "identify 1", "start", "stop", "steer", "error 2", "error 3", "error 4", "error 5"]
    {
        assert!(questions.iter().any(|q| q.expected.starts_with(name)), "no {name} among the questions");
    }
    compare(&questions);
}

fn random_extension(random: &mut Pcg64Mcg, n: usize) -> Extension {
    let unit = |random: &mut Pcg64Mcg| ChannelUnit {
        channel: random.random(),
        unit: Unit::of(random.random()),
        scale: random.random(),
        exponent: random.random(),
        zero: random.random_range(-(1 << 23)..1 << 23),
    };
    let units = (0..n % 8).map(|_| unit(random)).collect();
    Extension { minor: 1, wide_tick: random.random(), boot_id: random.random(), units }
}

fn random_answer(random: &mut Pcg64Mcg, n: usize) -> Answer {
    match n % 5 {
        0 => {
            let channels = random.random_range(9..=MAX_CHANNELS);
            Answer::Identity(BoardIdentity {
                tick_hz: random.random(),
                converter: Converter {
                    bits: random.random(),
                    range_v: f64::from(random.random::<u32>()) * 1e-3,
                },
                output_bits: random.random(),
                simulated: random.random(),
                rate_mhz: random.random(),
                roles: (0..channels).map(|_| Role::of(random.random())).collect(),
                skew_ns: (0..channels).map(|_| random.random()).collect(),
                name: "Prüfstand 7, µC 1.0"[..n % 15].trim().into(),
                extensible: n.is_multiple_of(2),
                extension: (n.is_multiple_of(2) && !n.is_multiple_of(3)).then(|| random_extension(random, n)),
            })
        }
        1 => Answer::Reply(Reply {
            start: random.random(),
            result: [StartResult::Done, StartResult::RateOutOfRange, StartResult::ParkOutOfRange][n % 3],
            rate_mhz: random.random(),
        }),
        2 => Answer::Ack {
            id: random.random(),
            result: [SteerResult::Accepted, SteerResult::OutOfRange, SteerResult::NotStarted][n % 3],
        },
        3 => {
            let channels = random.random_range(0..=MAX_CHANNELS);
            let code = |i: usize| if i < channels { random.random_range(-(1 << 23)..1 << 23) } else { 0 };
            let codes = std::array::from_fn(code);
            let format = [ScanFormat::Short, ScanFormat::LONG, ScanFormat::Long { wide_tick: true }][n % 3];
            let tick: u64 = random.random();
            Answer::Scan(BoardScan {
                format,
                sequence: random.random(),
                tick: tick >> (64 - format.tick_bits()),
                applied: (format != ScanFormat::Short && !n.is_multiple_of(4)).then(|| random.random()),
                output_railed: random.random(),
                lease_expired: random.random(),
                overrun: random.random(),
                channels: channels as u8,
                codes,
            })
        }
        _ => Answer::Error {
            reason: [ErrorReason::Corrupted, ErrorReason::Type, ErrorReason::Value][n % 3],
            kind: random.random(),
        },
    }
}

#[test]
fn answers_have_the_same_frames() {
    let mut random = Pcg64Mcg::seed_from_u64(4);
    let answers = (0..INPUTS).map(|n| random_answer(&mut random, n));
    compare(&answers.map(|a| answer(&a)).collect::<Vec<_>>());
}

/// Every example of the document is decoded and encoded by both.
#[test]
fn the_examples_of_the_document_are_the_same() {
    let (mut questions, mut examples) = (Vec::new(), 0);
    for block in DOCUMENT.split("```text\nmessage ").skip(1) {
        let (message, rest) = block.split_once("frame ").unwrap();
        let parse = |text: &str| -> Vec<u8> {
            text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
        };
        let (message, line) = (parse(message), parse(rest.split_once("```").unwrap().0));
        let body = &message[..message.len() - 4];
        let (received, framed) = (receive(&line), frame(body));
        assert_eq!((&received.expected, &framed.expected), (&hex(body), &hex(&line)));
        questions.extend([received, framed]);
        if body[0] == BUSY {
            continue; // only boards on a network send it; the firmware is for serial lines
        }
        questions.push(if body[0] < 0x80 {
            request(body, MINOR)
        } else {
            answer(&Answer::decode(body).unwrap())
        });
        examples += 1;
    }
    assert_eq!(examples, 13, "one example for each message");
    compare(&questions);
}
