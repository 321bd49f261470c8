//! The guided experiment, with this test as the operator and a real daemon on the twin.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Output, Stdio};
use std::sync::mpsc;

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

use super::{command, deviation, number, points, rows, said, table2};
use crate::testkit::{Daemon, PATIENCE, Stream};

/// Starts the command with this input.
fn reading(out: &Path, arguments: &[&str], input: Stdio) -> Child {
    command(out, arguments).stdin(input).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// The whole input is known in advance and is written to a pipe.
fn typed(out: &Path, arguments: &[&str], text: &str) -> Output {
    let mut child = reading(out, arguments, Stdio::piped());
    child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap_or_default();
    child.wait_with_output().unwrap()
}

/// The command, its output as it appears, and a terminal on its standard input.
struct Person {
    child: Child,
    keys: File,
    heard: mpsc::Receiver<String>,
    all: String,
}

impl Person {
    fn at(out: &Path, arguments: &[&str]) -> Self {
        let keys = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&keys).unwrap();
        unlockpt(&keys).unwrap();
        let terminal = File::open(ptsname(&keys, Vec::new()).unwrap().to_str().unwrap()).unwrap();
        let mut child = reading(out, arguments, terminal.into());
        let (sender, heard) = mpsc::channel();
        let mut errors = BufReader::new(child.stderr.take().unwrap());
        std::thread::spawn(move || {
            // Prompts end with ": " and without a line feed.
            let mut text = String::new();
            let mut byte = [0];
            while errors.read(&mut byte).unwrap() > 0 {
                text.push(byte[0] as char);
                if text.ends_with('\n') || text.ends_with(": ") {
                    sender.send(std::mem::take(&mut text)).unwrap_or_default();
                }
            }
        });
        Self { keys: File::from(keys), child, heard, all: String::new() }
    }

    /// Waits until the command has printed this text.
    fn expects(&mut self, what: &str) {
        let mut since = String::new();
        while !since.contains(what) {
            let Ok(text) = self.heard.recv_timeout(PATIENCE) else { panic!("never {what}: {}", self.all) };
            self.all += &text;
            since += &text;
        }
    }

    fn types(&mut self, line: &str) {
        writeln!(self.keys, "{line}").unwrap();
    }

    /// The exit code of the command, and its whole output.
    fn end(mut self) -> (Option<i32>, String) {
        // The end of the input, after the typed text: closing the terminal would discard that text.
        let _ = self.keys.write_all(b"\x04");
        let mut out = String::new();
        BufReader::new(self.child.stdout.take().unwrap())
            .lines()
            .map_while(Result::ok)
            .for_each(|line| out += &line);
        let status = self.child.wait().unwrap();
        self.all.extend(self.heard.iter());
        (status.code(), self.all + &out)
    }
}

/// A daemon that stays locked also on a busy machine: its loop is slow, and so is the mirror of the twin.
fn daemon(config: &str) -> (Daemon, Stream, String) {
    let mut daemon = Daemon::start(&format!("{PATIENT}{config}"));
    let address = daemon.address();
    (daemon, Stream::tcp(address), address.to_string())
}

const PATIENT: &str = "centering.loop_delay_ms = 100.0\nrealtime.stall_ms = 0\n";
const REST: &str = "twin.motion = []\n";

#[test]
fn the_operator_moves_the_stage_and_types_the_interferometer_readings() {
    let step = |um: u32, from: u32, until: &str| {
        format!("{{ axis = \"tx\", kind = \"step\", amount_um = {um}, from_s = {from}{until} }}")
    };
    let motion = [step(20, 5, ", until_s = 10.0"), step(40, 10, "")].join(", ");
    let (_daemon, mut stream, at) = daemon(&format!("twin.motion = [{motion}]\n"));
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let arguments = ["--connect", &at, "--axes", "tx", "--points", "3", "--interval", "tx=20", "--rest", "1"];
    let mut person = Person::at(&out, &arguments);
    // The mirror of the twin moves by itself; the test answers when it has arrived. The interferometer has
    // its own zero.
    for (point, level) in [(1, 0.0), (2, 20e-6), (3, 40e-6)] {
        person.expects(&format!("tx point {point} of 3: move the stage to "));
        stream.skip_to_now();
        stream.until("the mirror is there", |frame| frame.locked() && (frame.pose[0] - level).abs() < 5e-6);
        person.types(&format!("{}", (level + 7e-6) * 1e6));
        person.expects("50 readings: ");
    }
    person.expects("do not move the mirror for 1 s");
    person.types("");
    let (code, said) = person.end();
    assert_eq!(code, Some(0), "{said}");
    let [measured, paper, predicted] = table2(&out)["tx"];
    assert_eq!(paper, 0.98);
    assert!((measured / predicted - 1.0).abs() < 0.4, "{measured} {predicted}"); // three points, each uncertain by 10 %
    for (point, level) in points(&out, "table2", "tx").iter().zip([0.0, 20.0, 40.0]) {
        let mean = point.iter().sum::<f64>() / 50.0;
        assert!((mean - level).abs() < 1.0 && deviation(point) < 2.0, "{mean} {level}");
    }
    let all = rows(&out.join("readings.csv"));
    let references: std::collections::BTreeSet<_> = all
        .iter()
        .filter(|r| r["part"] == "table2")
        .map(|r| (1e6 * number(r, "reference_si")).round() as i64)
        .collect();
    assert_eq!(references.into_iter().collect::<Vec<_>>(), [7, 27, 47]);
    assert!(all.iter().filter(|r| r["part"] == "rest").count() > 900);
    assert!(all.iter().all(|r| r["status"].contains("SIMULATED") && number(r, "time_ns") > 1e18));
    let report = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(report.contains("simulated by the digital twin") && report.contains("Status: UNCALIBRATED"));
    assert!(report.contains("150 readings, 20") && report.contains(" UTC. Status"));
}

#[test]
fn references_come_from_a_file_and_invalid_answers_are_prompted_again() {
    let (_daemon, _stream, at) = daemon(REST);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lab.csv");
    // As a spreadsheet program saves it in many countries.
    std::fs::write(
        &file,
        "\u{feff}axis;unit;point;reference\r\nyaw;urad;1;-10\r\nyaw;urad;2;0\r\nyaw;urad;3;10,5\r\n",
    )
    .unwrap();
    let out = folder.path().join("out");
    let arguments = [
        "--connect",
        &at,
        "--reference",
        file.to_str().unwrap(),
        "--readings",
        "20",
        "--average",
        "4",
        "--rest",
        "0",
    ];
    let mut person = Person::at(&out, &arguments);
    for line in ["b", "", "5", "", ""] {
        person.types(line);
        person.expects("then Enter: ");
    }
    let (code, told) = person.end();
    assert_eq!(code, Some(0), "{told}");
    assert!(told.contains("this is the first point"), "{told}");
    assert!(told.contains("the reference of this point is in the file"), "{told}");
    assert!(told.contains("yaw point 3 of 3: move the stage to +10.50 urad, then Enter: "), "{told}");
    let all = rows(&out.join("readings.csv"));
    assert_eq!(all.len(), 60);
    assert!((number(&all[59], "reference_si") - 10.5e-6).abs() < 1e-15);
    assert_eq!((number(&all[0], "averaged"), number(&all[0], "point")), (4.0, 1.0));
    // Poses at rest, 4 of them in each reading.
    assert!((number(&all[0], "sd_yaw_rad") / 1.247e-6 - 1.0).abs() < 0.1);
}

#[test]
fn readings_survive_the_end_of_the_daemon_and_a_point_can_be_repeated() {
    let (mut first, _stream, at) = daemon(REST);
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let options = ["--axes", "tz,pitch", "--points", "3", "--readings", "10", "--rest", "0"];
    let mut person = Person::at(&out, &[&["--connect", &at], &options[..]].concat());
    person.expects("tz point 1 of 3: move the stage to -0.93 um, type the interferometer's reading in um: ");
    for bad in ["", "1,5", "three", "1 urad", "1 m"] {
        person.types(bad);
        person.expects("type the interferometer's reading in um: ");
    }
    for line in ["0", "1", "b", "0.0011 mm", "2", "0"] {
        person.types(line);
        person.expects("type the interferometer's reading in ");
    }
    assert!(person.all.contains("pitch point 2 of 3"), "{}", person.all);
    let lost = at;
    first.signal(rustix::process::Signal::KILL);
    person.expects("continue with the same options and --resume");
    let (code, told) = person.end();
    assert_eq!(code, Some(69), "{told}");
    for word in [
        "\"1,5\" is not a number in um",
        "\"urad\" is not a unit for tz",
        "40 readings are stored in",
        "--resume",
        "from the target",
    ] {
        assert!(told.contains(word), "{word}: {told}");
    }
    first.end();
    let (second, _stream, at) = daemon(REST);
    let other = typed(&out, &["--connect", &at, "--resume", "--axes", "yaw"], "");
    assert_eq!(other.status.code(), Some(64));
    assert!(
        said(&other).contains(&format!("readings.csv contains \"source: tcp://{lost}\"")),
        "{}",
        said(&other)
    );
    drop(second);
    let (_third, _stream, at) = daemon(&format!(
        "{REST}publishing.tcp = \"{lost}\"
"
    ));
    let options_of = |options: &[&str]| typed(&out, &[&["--connect", &at, "--resume"], options].concat(), "");
    for changed in [
        &["--axes", "yaw"][..],
        &["--axes", "tz,pitch", "--points", "3", "--readings", "20"],
        &["--axes", "tz,pitch", "--points", "3", "--readings", "10", "--average", "2"],
        &["--axes", "tz,pitch", "--points", "3", "--readings", "10", "--interval", "tz=2"],
    ] {
        let other = options_of(changed);
        assert_eq!(other.status.code(), Some(64));
        let told = said(&other);
        assert!(told.contains("options: 10 readings at each point, tz 3 points from -0.930000"), "{told}");
    }
    let output = typed(&out, &[&["--connect", &at, "--resume"], &options[..]].concat(), "10\n20\n");
    assert!(output.status.success(), "{}", said(&output));
    let all = rows(&out.join("readings.csv"));
    assert_eq!(all.len(), 60);
    let second = all.iter().find(|r| r["axis"] == "tz" && r["point"] == "2").unwrap();
    assert!((number(second, "reference_si") - 1.1e-6).abs() < 1e-15);
}

#[test]
fn unusable_poses_are_reported_and_the_point_is_prompted_again() {
    for (config, told) in [
        ("centering.mode = \"off\"\n", "the pose is valid, the loop is off"),
        ("twin.fault = [{ kind = \"psd-dark\", psd = 2, at_s = 0.0 }]\n", "PSD_C_LOW"),
    ] {
        let (_daemon, _stream, at) = daemon(&format!("{REST}{config}"));
        let folder = tempfile::tempdir().unwrap();
        let output = typed(&folder.path().join("out"), &["--connect", &at], "0\n");
        let said = said(&output);
        assert_eq!(output.status.code(), Some(69), "{said}");
        for word in ["no usable pose for 5 s", told, "solve this and try again", "no readings are stored"] {
            assert!(said.contains(word), "{word}: {said}");
        }
    }
}

#[test]
fn a_tare_between_points_of_an_axis_is_detected() {
    let folder = tempfile::tempdir().unwrap();
    let (daemon, _stream, at) = daemon(REST);
    let out = folder.path().join("out");
    let mut person =
        Person::at(&out, &["--connect", &at, "--axes", "roll", "--points", "3", "--readings", "5"]);
    person.types("0");
    person.expects("roll point 2 of 3");
    daemon.reload(&format!("{PATIENT}{REST}frames.tare.rotation_deg = [0.1, 0.0, 0.0]\n"));
    person.types("15");
    person.expects("geometry, calibration or frames of the sensor have changed");
    person.types("q");
    let (code, told) = person.end();
    assert_eq!(code, Some(130), "{told}");
    assert!(told.contains("5 readings are stored in"), "{told}");
}

#[test]
fn a_tare_during_the_record_at_rest_restarts_the_record() {
    let folder = tempfile::tempdir().unwrap();
    let (daemon, mut stream, at) = daemon(REST);
    let file = folder.path().join("lab.csv");
    std::fs::write(&file, "axis,unit,point,reference\ntx,um,1,0\ntx,um,2,1\ntx,um,3,2\n").unwrap();
    let out = folder.path().join("out");
    let arguments =
        ["--connect", &at, "--reference", file.to_str().unwrap(), "--readings", "5", "--rest", "3"];
    let mut person = Person::at(&out, &arguments);
    for _ in 0..3 {
        person.types("");
    }
    person.expects("Enter starts it");
    person.types("");
    person.expects("recording");
    stream.skip_to_now();
    stream.take(1500); // half of the record
    daemon.reload(&format!("{PATIENT}{REST}frames.tare.rotation_deg = [0.1, 0.0, 0.0]\n"));
    person.expects("have changed (a tare?): the record starts again");
    let (code, told) = person.end();
    assert_eq!(code, Some(0), "{told}");
    let all = rows(&out.join("readings.csv"));
    let configs: std::collections::BTreeSet<_> =
        all.iter().filter(|r| r["part"] == "rest").map(|r| r["config"].clone()).collect();
    assert_eq!(configs.len(), 1);
}

#[test]
fn input_from_a_pipe_ends_at_a_refused_point() {
    let (_daemon, _stream, at) = daemon(REST);
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let options = ["--connect", &at, "--axes", "tx", "--points", "3", "--readings", "5", "--rest", "1"];
    for (bad, why) in [
        ("1 m", "from the target +0.00 um"),
        ("0", "the reference of the previous point"),
        ("x", "not a number"),
    ] {
        let output = typed(&out, &options, &format!("0\n{bad}\n2\n"));
        let told = said(&output);
        assert_eq!(output.status.code(), Some(65), "{told}");
        for word in [why, "the input is not a terminal", "5 readings are stored in"] {
            assert!(told.contains(word), "{word}: {told}");
        }
        assert_eq!(rows(&out.join("readings.csv")).len(), 5);
        std::fs::remove_dir_all(&out).unwrap();
    }
    // One answer for each point: there is no record at rest, but a report.
    let output = typed(&out, &options, "0\n1\n2\n");
    assert!(output.status.success(), "{}", said(&output));
    assert!(said(&output).contains("the report is made without a record at rest"), "{}", said(&output));
    assert!(out.join("report.html").exists());
    let short = [&options[..8], &["--rest", "0.01"]].concat();
    let output = typed(&folder.path().join("short"), &short, "");
    assert_eq!(output.status.code(), Some(64), "{}", said(&output));
    assert!(said(&output).contains("at least 64 are needed, or --rest 0"), "{}", said(&output));
    assert!(!folder.path().join("short").exists());
}

#[test]
fn a_folder_belongs_to_one_session_and_is_empty_again_after_b() {
    let (_daemon, _stream, at) = daemon(REST);
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let options = ["--connect", &at, "--axes", "tx", "--points", "3", "--readings", "5", "--rest", "1"];
    let mut person = Person::at(&out, &options);
    person.expects("tx point 1 of 3");
    let second = typed(&out, &options, "0\n");
    assert_eq!(second.status.code(), Some(75), "{}", said(&second));
    assert!(said(&second).contains("another session uses"), "{}", said(&second));
    for (line, heard) in [
        ("0", "point 2 of 3"),
        ("b", "point 1 of 3"),
        ("0", "point 2 of 3"),
        ("1", "point 3 of 3"),
        ("2", "Enter starts it"),
        ("b", "point 3 of 3"),
        ("2", "Enter starts it"),
        ("b", "point 3 of 3"),
        ("b", "point 2 of 3"),
        ("b", "point 1 of 3"),
    ] {
        person.types(line);
        person.expects(heard);
    }
    person.types("q");
    let (code, told) = person.end();
    assert!(code == Some(130) && told.contains("no readings are stored"), "{told}");
    let again = typed(&out, &[&options[..], &["--resume"]].concat(), "0\n1\n2\n");
    assert!(again.status.success(), "{}", said(&again));
}
