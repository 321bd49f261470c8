use proptest::prelude::*;

use super::*;

fn axes() -> Axes {
    ["1".into(), "Y_2".into()]
}

fn answer(bytes: &[u8]) -> Answer {
    let mut answer = Answer::default();
    assert_eq!(answer.push(bytes), Ok(true), "{bytes:?}");
    answer
}

#[test]
fn lines_are_those_of_the_manual() {
    assert_eq!(GcsQuery::Identity.line(&axes()), "*IDN?\n");
    assert_eq!(GcsQuery::Error.line(&axes()), "ERR?\n");
    assert_eq!(GcsQuery::Position.line(&axes()), "POS? 1 Y_2\n");
    let line = move_to(&axes(), [10.0, -0.000_12]).unwrap();
    assert_eq!(line, "MOV 1 10.0000000 Y_2 -0.0001200\nERR?\n");
    assert_eq!(servo_on(&axes()), "SVO 1 1 Y_2 1\nERR?\n");
}

#[test]
fn an_answer_ends_with_the_first_line_that_does_not_end_with_a_space() {
    let mut coming = Answer::default();
    for part in ["1=-1158.4405", " ", "\nY_2=+0000", ".25"] {
        assert_eq!(coming.push(part.as_bytes()), Ok(false), "{part:?}");
    }
    assert_eq!(coming.so_far(), "1=-1158.4405 Y_2=+0000.25");
    assert_eq!(coming.push(b"\n"), Ok(true));
    assert_eq!(coming.numbers(&axes()), Ok([-1158.4405, 0.25]));
    assert_eq!(coming.push(b"0\n"), Err(AnswerError::Surplus("0\n".into())));
}

#[test]
fn values_are_parsed_by_type() {
    assert_eq!(answer(b"7\n").code(), Ok(7));
    assert_eq!(answer(b"-1024\n").code(), Ok(-1024));
    assert_eq!(answer(b"1=1 \nY_2=0\n").flags(&axes()), Ok([true, false]));
    assert_eq!(answer(b"1=\xb5m \nY_2=MM\n").words(&axes()), Ok(["\u{b5}m".into(), "MM".into()]));
    assert_eq!(answer(b"(c) Example, E-1, 007, 1.0\n").line("a name"), Ok("(c) Example, E-1, 007, 1.0"));
}

#[test]
fn unexpected_answers_are_refused_with_the_expected_one() {
    let numbers = |bytes| answer(bytes).numbers(&axes()).unwrap_err().to_string();
    let wrong: [&[u8]; 8] = [
        b"1=1.0 \n3=2.0\n",         // another axis
        b"Y_2=2.0 \n1=1.0\n",       // in another order
        b"1=1.0\n",                 // one axis
        b"1=1.0 \nY_2=2.0 \n3=0\n", // three
        b"1=nan \nY_2=2.0\n",
        b"1=inf \nY_2=2.0\n",
        b"1= \nY_2=2.0\n",
        b"0\n",
    ];
    for bytes in wrong {
        let message = numbers(bytes);
        assert!(message.contains("1= and Y_2=, each with a number"), "{message}");
    }
    assert!(numbers(b"1=1.0 \n3=2.0\n").contains("1=1.0 3=2.0"));
    assert!(answer(b"1=1.0 \nY_2=2.0\n").code().is_err() && answer(b"5.5\n").code().is_err());
    assert!(answer(b"1=2 \nY_2=0\n").flags(&axes()).is_err());
}

#[test]
fn the_length_of_an_answer_is_limited() {
    let mut endless = Answer::default();
    assert_eq!(endless.push(&[b'x'; LINE]), Ok(false));
    assert_eq!(endless.push(b"x"), Err(AnswerError::TooLong));
    assert_eq!(Answer::default().push(&b"x \n".repeat(LINES)), Err(AnswerError::TooLong));
    assert_eq!(Answer::default().push(b"1=\x07"), Err(AnswerError::NotText(7)));
}

proptest! {
    #[test]
    fn numbers_survive_a_round_trip(
        a in -1e6..1e6_f64, b in -1e6..1e6_f64, cut in 0..20_usize,
    ) {
        let text = format!("1={a:+.6} \nY_2={b:.6e}\n");
        let (begin, rest) = text.as_bytes().split_at(cut.min(text.len() - 1));
        let mut answer = Answer::default();
        prop_assert_eq!(answer.push(begin), Ok(false));
        prop_assert_eq!(answer.push(rest), Ok(true));
        let read = answer.numbers(&axes()).unwrap();
        prop_assert!((read[0] - a).abs() < 1e-6 && (read[1] - b).abs() <= 1e-6 * b.abs());
    }

    #[test]
    fn a_motion_needs_two_finite_numbers(a in any::<f64>(), b in any::<f64>()) {
        match move_to(&axes(), [a, b]) {
            None => prop_assert!(!(a.is_finite() && b.is_finite())),
            Some(line) => {
                let motion = line.strip_suffix("\nERR?\n").unwrap();
                let words: Vec<_> = motion.split(' ').collect();
                let numbers = [words[2], words[4]].map(|word| word.parse::<f64>().unwrap());
                prop_assert_eq!((words.len(), words[0], words[1], words[3]), (5, "MOV", "1", "Y_2"));
                prop_assert!((numbers[0] - a).abs() <= 1e-7 && (numbers[1] - b).abs() <= 1e-7);
            }
        }
    }

    #[test]
    fn any_bytes_are_accepted_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
        let mut answer = Answer::default();
        if answer.push(&bytes) == Ok(true) {
            let _ = (answer.code(), answer.flags(&axes()), answer.words(&axes()));
            if let Ok(numbers) = answer.numbers(&axes()) {
                prop_assert!(numbers.iter().all(|x| x.is_finite()));
            }
        }
        prop_assert!(answer.so_far().chars().count() <= 80);
    }
}
