//! Answers of a stage's controller: they end or are refused, their length is limited, and parsed numbers
//! are finite.

#![no_main]

use libfuzzer_sys::fuzz_target;
use trifacet::steering::gcs::protocol::{Answer, move_to};

fuzz_target!(|bytes: &[u8]| {
    let axes = ["1".to_owned(), "B_2".to_owned()];
    // The bytes as they are, and as values of the axes, so that the fuzzer need not guess these.
    let (x, y) = bytes.split_at(bytes.len() / 2);
    let values = [b"1=", x, b" \nB_2=", y, b"\n"].concat();
    for said in [bytes, &values] {
        let mut answer = Answer::default();
        let mut complete = false;
        for part in said.chunks(7) {
            match answer.push(part) {
                Ok(done) => complete = done,
                Err(_) => return,
            }
        }
        assert!(answer.so_far().chars().count() <= 80, "a short message");
        if !complete {
            assert!(said.len() <= 8 * 257, "an answer that never ends");
            continue;
        }
        let _ = (answer.code(), answer.flags(&axes), answer.words(&axes), answer.line("a line"));
        if let Ok(numbers) = answer.numbers(&axes) {
            assert!(move_to(&axes, numbers).is_some(), "{numbers:?}");
        }
    }
});
