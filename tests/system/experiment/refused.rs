//! Errors name the cause and its place, and nothing is overwritten.

use std::fs;
use std::path::Path;

use super::{done, run, said};

/// The command must exit with this code and these messages, and must not write a report.
fn refuses(arguments: &[&str], code: i32, told: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let output = run(&out, arguments);
    let said = said(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
    assert!(told.iter().all(|told| said.contains(told)), "{arguments:?}: {told:?}, but: {said}");
    assert!(!out.join("report.html").exists());
}

#[test]
fn invalid_options_are_named() {
    for (arguments, told) in [
        (&["--axes", "tx,x"][..], "allowed are tx, ty, tz, roll, pitch, yaw"),
        (&["--points", "2"], "allowed is 3 to 10000"),
        (&["--readings", "1"], "allowed is 2 to 100000"),
        (&["--interval", "tx"], "AXIS=X"),
        (&["--interval", "tx=0"], "above 0 and at most 1000 um"),
        (&["--interval", "roll=5um"], "\"um\" is not a unit for roll"),
        (&["--axes", "tx", "--interval", "ty=2"], "ty is not among the --axes"),
        (&["--interval", "ty=2,ty=3"], "--interval contains ty twice"),
        (&["--rest=-1"], "from 0 to 86400"),
        (&["--rest", "0.06"], "--rest 0.06 gives 60 poses: at least 64 are needed, or --rest 0"),
        (&["--connect", "udp://127.0.0.1:7362"], "HOST:PORT"),
        (&["--connect", "127.0.0.1:1", "--seed", "1"], "cannot be used with"),
        (&["--from", "a.csv", "--points", "5"], "cannot be used with"),
        (&["--resume"], "requires --connect HOST:PORT"),
        (&["--resume", "--seed", "1"], "requires --connect HOST:PORT"),
        (&["--resume", "--paper-only"], "requires --connect HOST:PORT"),
        (&["--resume", "--from", "a.csv"], "requires --connect HOST:PORT"),
    ] {
        refuses(arguments, 64, &[told]);
    }
}

#[test]
fn a_folder_that_is_not_empty_is_refused_and_not_changed() {
    let folder = tempfile::tempdir().unwrap();
    let precious = folder.path().join("readings.csv");
    fs::write(&precious, "mine").unwrap();
    let output = run(folder.path(), &["--axes", "tx"]);
    assert_eq!(output.status.code(), Some(74));
    assert!(said(&output).contains("is not empty") && said(&output).contains("--out"), "{}", said(&output));
    assert_eq!(fs::read_to_string(&precious).unwrap(), "mine");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_full_disk_is_reported_and_leaves_no_files() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    // Files may not grow beyond 100 kB in this shell: writing fails as on a full disk.
    let script = "ulimit -f 100; exec \"$@\"";
    let output = std::process::Command::new("bash")
        .args(["-c", script, "-", env!("CARGO_BIN_EXE_trifacet"), "experiment", "--paper-only", "--out"])
        .arg(&out)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(74), "{}", said(&output));
    assert!(said(&output).contains("cannot write") && said(&output).contains("readings.csv"));
    assert!(!out.exists(), "the new folder is removed");
}

fn file(folder: &Path, text: &str) -> String {
    let file = folder.join("in.csv");
    fs::write(&file, text).unwrap();
    file.to_str().unwrap().into()
}

#[test]
fn invalid_references_are_reported_with_their_line() {
    let folder = tempfile::tempdir().unwrap();
    for (text, told) in [
        ("axis,unit,reference\n", "the column point is missing; required are axis, unit, point, reference"),
        ("axis,unit,point,reference,reference\n", "the column reference occurs twice"),
        ("axis,unit,point,reference\n", "the file contains no readings"),
        (
            "axis,unit,point,reference\ntx,urad,1,0\n",
            ":2: unit is \"urad\": allowed is one of um, nm, mm, m for tx",
        ),
        (
            "axis,unit,point,reference\nx,um,1,0\n",
            ":2: axis is \"x\": allowed is tx, ty, tz, roll, pitch or yaw",
        ),
        ("axis,unit,point,reference\ntx,um,1,-\n", ":2: reference is \"-\": allowed is a finite number"),
        ("axis,unit,point,reference\ntx,um,1,0\ntx,um,2,1\n", "tx has 2 points: at least 3"),
    ] {
        let file = file(folder.path(), text);
        refuses(&["--reference", &file], 65, &[told, "in.csv"]);
    }
    let utf16: Vec<u8> = "\u{feff}axis;unit".encode_utf16().flat_map(u16::to_le_bytes).collect();
    for (bytes, told) in [
        (&utf16[..], "in.csv:1:1: the text is in UTF-16"),
        (b"axis;unit;point;reference\r\ntx;um;1;0,5\r\ntx;um;2;1.5\r\n", "in.csv:3: reference is \"1.5\""),
        (b"axis,unit,point,reference\ntx,\xb5m,1,0\n", "in.csv:2: unit contains the byte 0xb5"),
    ] {
        let file = folder.path().join("in.csv");
        fs::write(&file, bytes).unwrap();
        refuses(&["--reference", file.to_str().unwrap()], 65, &[told]);
    }
    let good = file(folder.path(), "axis,unit,point,reference\ntx,um,1,0\ntx,um,2,1\ntx,um,3,2\n");
    refuses(&["--reference", &good, "--axes", "yaw"], 65, &["no readings of yaw"]);
    refuses(&["--reference", "nowhere.csv"], 74, &["cannot read nowhere.csv"]);
}

#[test]
fn invalid_readings_are_reported_with_their_line() {
    let (folder, out) =
        done(&["--axes", "tx", "--points", "4", "--readings", "3", "--paper-only", "--rest", "0"]);
    let text = fs::read_to_string(out.join("readings.csv")).unwrap();
    let text = &text[text.find("part,").unwrap()..]; // without the lines that state the source
    let lines = |n: usize| text.split_inclusive('\n').take(n).collect::<String>();
    let wrong = |from: &str, to: &str| {
        let (head, rest) = text.split_at(text.find('\n').unwrap());
        format!("{head}{}", rest.replacen(from, to, 1))
    };
    let deviation = text.lines().nth(1).unwrap().split(',').nth(12).unwrap();
    let negative = wrong(deviation, &format!("-{deviation}"));
    for (text, told) in [
        (lines(1), "the file contains no readings"),
        (lines(1 + 2 * 3), "tx has readings at 2 points: at least 3 are needed"),
        (lines(1 + 3 * 3 + 1), "tx point 4: 1 readings, at least 2 are needed"),
        (wrong("table2", "table3"), ":2: part is \"table3\": allowed is table2, beyond or rest"),
        (wrong(",tx,", ",up,"), ":2: axis is \"up\""),
        (wrong("POSE_VALID", "POSE_FINE"), ":2: status is \"POSE_FINE"),
        (text.replacen("reference_si", "reference", 1), "the column reference_si is missing"),
        (wrong("POSE_VALID", ""), ":2: its status does not contain POSE_VALID"),
        (lines(2) + &lines(2)[lines(1).len()..], ":3: this reading occurs twice"),
        (negative, ":2: a standard uncertainty (sd_...) is not above 0"),
        (
            text.lines().filter(|line| !line.contains(",tx,2,")).flat_map(|line| [line, "\n"]).collect(),
            "tx point 2 is missing",
        ),
        (lines(5) + "table2,tx,1\n", ":6: 3 fields where the header has"),
        (lines(13).replace(",tx,4,1,", ",tx,3,4,"), "tx point 3: its readings have different references"),
    ] {
        let file = file(folder.path(), &text);
        refuses(&["--from", &file], 65, &[told]);
    }
}

#[test]
fn a_twin_without_a_valid_pose_reports_the_point_and_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let config = |text: &str| {
        let file = folder.path().join("lab.toml");
        fs::write(&file, text).unwrap();
        file.to_str().unwrap().to_owned()
    };
    let dark = config("twin.fault = [{ kind = \"psd-dark\", psd = 1, at_s = 1.0 }]\n");
    refuses(
        &["--config", &dark, "--axes", "ty"],
        69,
        &["ty point ", " of 21, at -", ", reading ", "PSD_B_LOW", "the pose is invalid"],
    );
    let off = config("centering.mode = \"off\"\n");
    refuses(
        &["--config", &off],
        69,
        &[
            "tx point 1 of 21, at -14.40 um, reading 1",
            "no usable pose for 5 s",
            "the pose is valid, the loop is off",
        ],
    );
    let board = config("acquisition.source = \"serial\"\n");
    refuses(&["--config", &board], 78, &["--connect HOST:PORT"]);
    let wrong = config("twin.seed = -1\n");
    refuses(&["--config", &wrong], 78, &["twin.seed"]);
}

#[test]
fn the_address_of_a_missing_daemon_is_reported() {
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    refuses(&["--connect", &free], 69, &["nothing listens at tcp://127.0.0.1:", "trifacet run"]);
}
