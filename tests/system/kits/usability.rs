//! The kits and the documents have the definition of a usable pose of `trifacet-wire`.

use std::io::Write as _;
use std::process::{Command, Stdio};

use trifacet_wire::Status;

use super::tools::{compile, python_with_packages, read};

/// Every status bit, with a valid pose and without one.
fn words() -> Vec<Status> {
    let bits = Status::NAMES.iter().map(|(bit, _)| *bit).chain([Status::default()]);
    bits.flat_map(|bit| [bit, bit | Status::POSE_VALID]).collect()
}

fn expected(permitted: Status) -> Vec<bool> {
    words().into_iter().map(|word| word.usable(permitted)).collect()
}

/// The answers of a program that reads status words and prints 0 or 1 for each.
fn answers(command: &mut Command) -> Vec<bool> {
    let mut program = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let lines = words().iter().map(|word| word.0.to_string()).collect::<Vec<_>>().join("\n");
    program.stdin.take().unwrap().write_all(lines.as_bytes()).unwrap();
    let output = program.wait_with_output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap().lines().map(|line| line == "1").collect()
}

#[test]
fn python_has_the_definition_of_the_code() {
    for (simulated, permitted) in
        [("False", Status::default()), ("True", Status::SIMULATED | Status::REPLAYED)]
    {
        let script = format!(
            "import sys, time, trifacet\n\
             empty = trifacet.Frame(*[0] * len(trifacet.Frame._fields))\n\
             for line in sys.stdin:\n    \
                 frame = empty._replace(status=int(line), time_ns=time.time_ns())\n    \
                 print(int(frame.usable(max_age=60, simulated={simulated})))\n"
        );
        assert_eq!(answers(python_with_packages().args(["-c", &script])), expected(permitted), "{simulated}");
    }
}

#[test]
fn c_has_the_definition_of_the_code() {
    let (_place, strict) = compile("tests/system/kits/usable.c", &[]);
    assert_eq!(answers(&mut Command::new(strict)), expected(Status::default()));
    let (_place, trusting) = compile("tests/system/kits/usable.c", &["-DTRIFACET_NOT_REAL=0"]);
    let permitted = Status::SIMULATED | Status::REPLAYED;
    assert_eq!(answers(&mut Command::new(trusting)), expected(permitted));
}

#[test]
fn the_mask_of_the_document_is_that_of_the_code() {
    let document = read("docs/plc.md");
    let hex = |bits: Status| format!("16#{:04X}_{:04X}", bits.0 >> 16, bits.0 & 0xffff);
    for (bit, name) in Status::NAMES.iter().filter(|(bit, _)| Status::UNUSABLE.has(*bit)) {
        let row = document.lines().find(|line| line.contains(&hex(*bit)) && line.contains(name));
        assert!(row.is_some(), "{name} is not in the list of forbidden bits");
    }
    let test = format!("(status AND {}) = 0", hex(Status::UNUSABLE));
    assert_eq!(document.matches(&test).count(), 1, "the definition");
    assert!(document.contains(&format!("(frame.status AND {}) = 0", hex(Status::UNUSABLE))), "the example");
}
