//! `trifacet board-test`: healthy boards keep all rules, and a wrong one breaks exactly the rules that its fault concerns.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::Value;

use super::board::{Board, Program};
use crate::testkit::{self, Socket, run, trifacet};

/// The report of `board-test` on this port, its exit code, and its standard error.
fn report(port: &Path, options: &[&str]) -> (Value, i32, String) {
    let ran = run(trifacet(&["board-test", "--json"]).arg(port).args(options));
    let report = serde_json::from_str(&ran.out).unwrap_or(Value::Null);
    (report, ran.code, ran.err)
}

/// The rules with this verdict.
fn rules<'a>(report: &'a Value, verdict: &str) -> BTreeSet<&'a str> {
    let all = report["rules"].as_array().unwrap_or_else(|| panic!("{report}"));
    all.iter().filter(|rule| rule["verdict"] == verdict).map(|rule| rule["rule"].as_str().unwrap()).collect()
}

/// Runs a check with each of these at the same time: a test of a board takes half a minute, in which the processor has
/// little to do.
fn each<T: Sync>(all: &[T], check: impl Fn(&T) + Sync) {
    std::thread::scope(|scope| {
        for one in all {
            scope.spawn(|| check(one));
        }
    });
}

#[test]
fn an_emulated_board_of_each_version_keeps_all_rules() {
    each(&["1.0", "1.1"], |version| {
        let mut board = testkit::Board::of_version(version, "");
        let (found, code, errors) = report(&board.link(), &["--move", "3000"]);
        assert_eq!((rules(&found, "FAIL"), code), (BTreeSet::new(), 0), "{version}: {found} {errors}");
        let skipped = rules(&found, "SKIP");
        let newer = BTreeSet::from(["applied-command", "boot-id", "long-scan"]);
        assert_eq!(*version == "1.0", newer.is_subset(&skipped), "{skipped:?}");
        // A busy machine cannot check the leases.
        assert!(rules(&found, "PASS").len() >= 20, "{found}");
        let status = board.status();
        assert_eq!(status["output_codes"], serde_json::json!([0, 0]), "sent back");
        assert_eq!(status["started"], false);
    });
}

#[test]
fn without_permission_nothing_moves() {
    let mut board = testkit::Board::start("");
    let (found, code, _) = report(&board.link(), &[]);
    assert_eq!((code, rules(&found, "FAIL").len()), (0, 0), "{found}");
    assert!(rules(&found, "SKIP").contains("lease-expires"), "{found}");
    let status = board.status();
    assert_eq!((&status["commands_taken"], &status["steering"]), (&0.into(), &"idle".into()));
}

#[test]
fn the_firmware_keeps_all_rules() {
    let program = Program::board();
    each(&["", "wide=1"], |arguments| {
        let board = Board::start(&program, arguments);
        let (found, code, errors) = report(&board.port(), &["--move", "3000", "--rate", "500"]);
        assert_eq!(rules(&found, "FAIL"), BTreeSet::new(), "{found} {errors}");
        assert_eq!((code, &found["passed"]), (0, &true.into()));
        assert!(
            rules(&found, "PASS").is_superset(&BTreeSet::from(["long-scan", "steer-accepted", "tick"])),
            "{found}"
        );
    });
}

/// Faults, and the rules that a board with them breaks.
const FAULTS: [(&str, &[&str]); 11] = [
    ("mute=133", &["damaged-frames", "empty-frames", "unknown-messages", "versions"]),
    (
        "mute=131",
        &[
            "full-buffer",
            "steer-accepted",
            "steer-each-scan",
            "steer-range",
            "steer-refused",
            "steer-stopped",
        ],
    ),
    ("wrong_ids=1", &["steer-accepted", "steer-each-scan", "steer-range", "steer-refused", "steer-stopped"]),
    ("no_lease=1", &["lease-expires", "lease-parks", "lease-refused", "lease-renewed", "lease-stop"]),
    ("no_park=1", &["lease-parks"]),
    ("keep_number=1", &["start", "start-repeated"]),
    ("rate_factor=1.2", &["full-buffer", "sample-rate", "tick"]),
    ("tick_factor=1.2", &["full-buffer", "sample-rate", "tick"]),
    ("at=1950 until=1951 tick_step=-5000", &["tick"]),
    ("new_boots=1", &["boot-id"]),
    ("no_applied=1", &["applied-command"]),
];

fn check_fault(program: &Program, arguments: &str, broken: &[&str]) {
    let board = Board::start(program, arguments);
    let (found, code, errors) = report(&board.port(), &["--move", "3000"]);
    assert_eq!(rules(&found, "FAIL"), broken.iter().copied().collect(), "{arguments}: {found}");
    assert_eq!((code, &found["passed"]), (65, &false.into()), "{arguments}");
    assert!(broken.iter().all(|rule| errors.contains(rule)), "{arguments}: {errors}");
    let all = found["rules"].as_array().unwrap();
    let details =
        |rule: &Value| rule["details"]["seen"].is_string() && rule["details"]["expected"].is_string();
    assert!(all.iter().filter(|rule| rule["verdict"] == "FAIL").all(details), "{found}");
}

#[test]
fn a_wrong_board_breaks_the_rules_that_its_fault_concerns() {
    let program = &Program::board();
    each(&FAULTS, |(arguments, broken)| check_fault(program, arguments, broken));
}

#[test]
fn a_verdict_names_what_was_seen_and_what_is_required() {
    let board = Board::start(&Program::board(), "new_boots=1");
    let ran = run(trifacet(&["board-test"]).arg(board.port()));
    assert_eq!(ran.code, 65, "{}", ran.err);
    let mut lines = ran.out.lines().skip_while(|line| !line.starts_with("FAIL  boot-id "));
    assert!(lines.next().is_some_and(|line| line.contains("seen: first Extension")), "{}", ran.out);
    assert!(lines.next().is_some_and(|line| line.contains("expected: the same fields")), "{}", ran.out);
    assert!(ran.out.lines().any(|line| line.starts_with("SKIP  lease-parks ")), "{}", ran.out);
}

#[test]
fn a_port_without_a_board_and_impossible_options_have_their_exit_codes() {
    let (_, code, errors) = report(Path::new("/dev/no-such-port"), &[]);
    assert!(code == 69 && errors.contains("/dev/no-such-port"), "{code}: {errors}");
    let silent = Board::start(&Program::board(), "mute=129");
    let (_, code, errors) = report(&silent.port(), &[]);
    assert!(code == 69 && errors.contains("no board answers") && errors.contains("921600 baud"), "{errors}");
    let board = testkit::Board::plug_into(Socket::new(), "");
    let (_, code, errors) = report(&board.link(), &["--move", "40000"]);
    assert!(code == 64 && errors.contains("1 to 32767"), "{errors}");
    let mut daemon = testkit::Daemon::on_port(&board.link(), "");
    daemon.client().samples(1);
    let (_, code, errors) = report(&board.link(), &[]);
    assert!(code == 75 && errors.contains("in use by process"), "{errors}");
}
