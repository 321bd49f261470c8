//! The firmware and `trifacet emulate` answer the same requests alike, and their outputs and leases agree.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trifacet::config::Config;
use trifacet::core::time::Mono;
use trifacet::twin::Emulator;
use trifacet_wire::actuator::{LeaseAction, OutputCommand};
use trifacet_wire::board::{Answer, Deframer, Request};

use super::codec::{Question, compare, hex};

/// Number of requests.
const REQUESTS: usize = 5000;

/// A request that is mostly possible. Identities differ between the boards, so none is asked for.
fn request(random: &mut Pcg64Mcg) -> Request {
    let code = |random: &mut Pcg64Mcg| match random.random_range(0..20) {
        0 => 32_768,
        1 => -32_769,
        2 => random.random(),
        3 => -32_768,
        _ => random.random_range(-32_768..32_768),
    };
    match random.random_range(0..20) {
        0 => Request::Stop,
        1..=3 => {
            let rate_mhz = if random.random_range(0..4) == 0 { random.random() } else { 1_000_000 };
            Request::Start { rate_mhz, park: [code(random), code(random)], minor: random.random_range(0..2) }
        }
        _ => Request::Steer(OutputCommand {
            id: random.random(),
            codes: [code(random), code(random)],
            lease_ms: random.random_range(0..30),
            on_expiry: if random.random() { LeaseAction::Park } else { LeaseAction::Hold },
        }),
    }
}

/// The frames of the emulator that are no scans.
pub(super) fn answers(board: &mut Emulator) -> String {
    let bytes = board.output().to_vec();
    board.written(bytes.len());
    let (mut rest, mut deframer, mut frames) = (&bytes[..], Deframer::default(), Vec::new());
    while let Some(message) = deframer.next(&mut rest) {
        let answer = Answer::decode(message.unwrap()).unwrap();
        if !matches!(answer, Answer::Scan(_)) {
            answer.encode(&mut frames);
        }
    }
    hex(&frames)
}

#[test]
fn the_firmware_and_the_emulator_answer_alike() {
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let mut board = Emulator::new(&Config::default(), Mono(0)).unwrap();
    let (mut now_ms, mut questions) = (0, Vec::new());
    for _ in 0..REQUESTS {
        now_ms += random.random_range(1..25);
        let mut bytes = Vec::new();
        request(&mut random).encode(&mut bytes);
        if random.random_range(0..20) == 0 {
            let place = random.random_range(0..bytes.len() - 1);
            bytes[place] = random.random();
        }
        // Between two milliseconds, so that no lease ends at this time.
        let now = Mono(now_ms * 1_000_000 + 500_000);
        board.sample(now);
        board.received(&bytes, now);
        let (frames, state) = (answers(&mut board), board.state());
        let [x, y] = state.output_codes;
        questions.push(Question {
            line: format!("board {} {}", now.0 / 1000, hex(&bytes)),
            expected: format!("{frames} {x} {y} {}", u8::from(state.lease_expired)),
        });
    }
    let expired = questions.iter().filter(|q| q.expected.ends_with(" 1")).count();
    assert!((REQUESTS / 10..REQUESTS).contains(&expired), "{expired} leases have expired");
    compare(&questions);
}
