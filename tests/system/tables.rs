//! `trace` and `solve` through the binary: the reference cases in both directions, and invalid tables.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Output, Stdio};
use std::sync::mpsc;

use crate::testkit::{self, Daemon, Folder, Killed, PATIENCE, on, run};

pub(crate) mod solve_options;

/// Runs the binary with this standard input.
fn trifacet(arguments: &[&str], input: &[u8]) -> Output {
    let mut child = testkit::trifacet(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let input = input.to_vec();
    let writer = std::thread::spawn(move || {
        let _ = stdin.write_all(&input); // a program that refuses the first line reads no more
    });
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap();
    output
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Columns of a CSV text by name, as text.
fn columns(csv: &[u8]) -> HashMap<String, Vec<String>> {
    let mut reader = csv::Reader::from_reader(csv);
    let header = reader.headers().unwrap().clone();
    let mut columns: HashMap<String, Vec<String>> = header.iter().map(|n| (n.into(), vec![])).collect();
    for record in reader.records() {
        for (name, field) in header.iter().zip(&record.unwrap()) {
            columns.get_mut(name).unwrap().push(field.into());
        }
    }
    columns
}

const POSE: [&str; 6] = ["tx_m", "ty_m", "tz_m", "roll_rad", "pitch_rad", "yaw_rad"];
const OFFSET: [&str; 2] = ["beam_dx_m", "beam_dy_m"];
const SPOTS: [&str; 6] = ["u_a_m", "v_a_m", "u_b_m", "v_b_m", "u_c_m", "v_c_m"];
const POWERS: [&str; 3] = ["power_a", "power_b", "power_c"];

fn assert_near(ours: &[u8], theirs: &[u8], names: &[&str], tolerance: f64, what: &str) {
    let (ours, theirs) = (columns(ours), columns(theirs));
    for name in names {
        assert_eq!(ours[*name].len(), theirs[*name].len(), "{what} {name}");
        for (row, (a, b)) in ours[*name].iter().zip(&theirs[*name]).enumerate() {
            let error = (a.parse::<f64>().unwrap() - b.parse::<f64>().unwrap()).abs();
            assert!(error <= tolerance, "{what} row {row} {name}: {a} against {b}");
        }
    }
}

/// The reference file through `trace` and through `solve`, with a configuration for its head.
fn reference(file: &str, model: &str, head: &str) {
    let path = format!("{}/tests/reference/{file}", env!("CARGO_MANIFEST_DIR"));
    let theirs = std::fs::read(&path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("head.toml");
    std::fs::write(&config, head).unwrap();
    let options = ["--config", config.to_str().unwrap(), "--model", model];
    let gaussian = model == "gaussian";

    let traced = trifacet(&[&["trace"], &options[..], &[&path]].concat(), b"");
    assert!(traced.status.success(), "{}", stderr(&traced));
    assert_near(&traced.stdout, &theirs, &SPOTS, if gaussian { 1e-11 } else { 1e-12 }, file);
    if gaussian {
        assert_near(&traced.stdout, &theirs, &POWERS, 1e-10, file);
    } else {
        assert!(!columns(&traced.stdout).contains_key("power_a"));
    }

    for input in [&theirs, &traced.stdout] {
        let solved = trifacet(&[&["solve"], &options[..], &["-"]].concat(), input);
        assert!(solved.status.success(), "{}", stderr(&solved));
        assert_near(&solved.stdout, &theirs, &POSE, 1e-10, file);
        if gaussian {
            assert_near(&solved.stdout, &theirs, &OFFSET, 1e-10, file);
        }
        let solved = columns(&solved.stdout);
        assert!(solved["status"].iter().all(|status| status == "ok"));
        let most = if head.contains("tilt") {
            16
        } else if gaussian {
            8
        } else {
            6
        };
        assert!(solved["iterations"].iter().all(|n| (1..=most).contains(&n.parse::<i32>().unwrap())));
    }
}

#[test]
fn the_ray_model_agrees_with_the_reference_in_both_directions() {
    reference("ray.csv", "ray", "");
    reference("ray_r180.csv", "ray", "head.psd_distance_mm = 180");
}

#[test]
fn the_gaussian_model_agrees_with_the_reference_in_both_directions() {
    reference("gaussian.csv", "gaussian", "");
    reference(
        "gaussian_r400_w500.csv",
        "gaussian",
        "head.psd_distance_mm = 400\nhead.beam_diameter_mm = 1.0",
    );
}

/// A configuration for a beam that turns about this point, millimetres.
fn tilted(pivot_mm: &str) -> String {
    format!("[steering]\nkind = \"tilt\"\ntilt.pivot_mm = {pivot_mm}\n")
}

#[test]
fn a_tilted_beam_agrees_with_the_reference_in_both_directions() {
    reference("tilt_z500.csv", "gaussian", &tilted("[0, 0, 500]"));
    reference("tilt_z1000_aside.csv", "gaussian", &tilted("[20, -10, 1000]"));
}

#[test]
fn only_check_trace_and_solve_accept_a_tilted_beam() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("tilt.toml");
    std::fs::write(&config, tilted("[0, 0, 500]")).unwrap();
    let config = config.to_str().unwrap();
    let output = trifacet(&["check", "--config", config], b"");
    let told = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(told.contains("a mirror that tilts the beam about the point [0.0, 0.0, 500.0] mm"), "{told}");
    // At rest, and with spots of 1.08 um: sideways better, about the horizontal axes worse than a parallel beam.
    assert!(told.contains("tx 0.79") && told.contains("roll 2.2"), "{told}");
    for command in [&["run"][..], &["simulate"], &["tune"], &["emulate"], &["budget"], &["park"], &["dark"]] {
        let output = trifacet(&[command, &["--config", config]].concat(), b"");
        let why = stderr(&output);
        assert_eq!(output.status.code(), Some(78), "{command:?}: {why}");
        assert!(why.contains("steering.kind = \"tilt\" is not possible here"), "{command:?}: {why}");
        assert!(why.contains("check, trace and solve"), "{command:?}: {why}");
    }
}

/// The figures of docs/sensor-model.md, section "Errors of the ray model".
#[test]
fn the_errors_of_the_ray_model_are_those_of_the_documentation() {
    let poses = "tx_m,ty_m,tz_m,roll_rad,pitch_rad,yaw_rad,beam_dx_m,beam_dy_m\n\
                 0,0,0,0,0,0,0,0\n\
                 0,0,0,0,0,0,1e-6,0\n\
                 0,0,0,0,0,0,1e-5,0\n\
                 0,0,0,0,0.01,0,0,0\n";
    let signals = trifacet(&["trace", "--model", "gaussian"], poses.as_bytes()).stdout;
    let solved = columns(&trifacet(&["solve", "--model", "ray"], &signals).stdout);
    let value = |row: usize, name: &str| solved[name][row].parse::<f64>().unwrap() * 1e6;
    let near = |ours: f64, documented: f64, half_a_digit: f64| {
        assert!((ours - documented).abs() <= half_a_digit, "{ours} is documented as {documented}");
    };
    near(value(0, "tz_m"), -119.2, 0.05);
    near(value(1, "tx_m"), 0.42, 0.005);
    near(value(1, "pitch_rad"), 0.68, 0.005);
    near(value(2, "tx_m"), 4.1, 0.05);
    near(value(2, "pitch_rad"), 6.8, 0.05);
    near(value(3, "tx_m"), -1.4, 0.05);
    near(value(3, "pitch_rad") - 10_000.0, -0.39, 0.005);

    // The Gaussian model has no such error.
    let known = columns(&trifacet(&["solve"], &signals).stdout);
    assert!(known["tx_m"].iter().all(|x| x.parse::<f64>().unwrap().abs() < 1e-12), "{known:?}");
    assert!((known["beam_dx_m"][2].parse::<f64>().unwrap() - 1e-5).abs() < 1e-12);
}

#[test]
fn columns_are_identified_by_name_in_any_order_and_quoting() {
    let dressed = "\u{feff}comment,\"yaw_rad\", pitch_rad,roll_rad,tz_m,ty_m,tx_m,beam_dy_m\r\n\
                   here; 1,0.001,0.002,0.003,1e-4,2e-4,3e-4,5e-6\r\n";
    let plain = "tx_m,ty_m,tz_m,roll_rad,pitch_rad,yaw_rad,beam_dx_m,beam_dy_m\n\
                 3e-4,2e-4,1e-4,0.003,0.002,0.001,0,5e-6\n";
    let [dressed, plain] = [dressed, plain].map(|text| trifacet(&["trace"], text.as_bytes()));
    assert!(dressed.status.success(), "{}", stderr(&dressed));
    assert_eq!(dressed.stdout, plain.stdout);
    // Seventeen significant digits in a notation that every reader accepts.
    let cell = &columns(&plain.stdout)["power_a"][0];
    assert_eq!(cell.split('e').next().unwrap().len(), "1.0123456789012345".len(), "{cell}");
}

/// Tables as spreadsheet programs save them.
#[test]
fn separators_decimal_commas_and_line_ends_do_not_matter() {
    let plain = "tx_m,ty_m,tz_m,roll_rad,pitch_rad,yaw_rad\n1e-4,-2.5e-4,0,0.001,0,-0.5e-3\n0,0,0,0,0,1e-3\n";
    let expected = trifacet(&["trace"], plain.as_bytes());
    assert!(expected.status.success(), "{}", stderr(&expected));
    let semicolons = plain.replace(',', ";");
    let german = plain.replace(',', ";").replace('.', ",");
    let table = [
        semicolons.clone(),
        german.clone(),
        german.replace(';', "\t"),
        german.replace(';', "\t").replace("0,001", "1,000e-3").replace("-0,5e-3", "-0,500e-3"),
        format!("\u{feff}{}", german.replace('\n', "\r\n")),
        german.replace('\n', "\r"),
        plain.replace('\n', "\r"),
        german.replace("1e-4", "\"1e-4\"").replace("-2,5", "\u{2212}2,5"),
        plain.replace("tx_m", "note,tx_m").replace("1e-4", "a;b,1e-4").replace("\n0,", "\nc;d,0,")
            + ",,,,,,\n",
    ];
    for text in table {
        let output = trifacet(&["trace"], text.as_bytes());
        assert!(output.status.success(), "{text:?}: {}", stderr(&output));
        assert_eq!(output.stdout, expected.stdout, "{text:?}");
    }
}

/// An earlier number has shown that the comma is the decimal mark.
#[test]
fn a_comma_that_is_known_as_the_decimal_mark_is_not_ambiguous() {
    let plain =
        "u_a_m,v_a_m,u_b_m,v_b_m,u_c_m,v_c_m,power_a,power_b,power_c\n0.0,0,0,0,0,0,1.250,1.250,1.250\n";
    let expected = trifacet(&["solve"], plain.as_bytes());
    assert!(expected.status.success(), "{}", stderr(&expected));
    for separator in [";", "\t"] {
        let german = plain.replace(',', separator).replace('.', ",");
        let output = trifacet(&["solve"], german.as_bytes());
        assert!(output.status.success(), "{german:?}: {}", stderr(&output));
        assert_eq!(output.stdout, expected.stdout, "{german:?}");
        let ambiguous = trifacet(&["solve"], german.replace("0,0", "0").as_bytes());
        assert_eq!(ambiguous.status.code(), Some(65), "{german:?}");
        assert!(stderr(&ambiguous).contains(":2: power_a is \"1,250\""), "{}", stderr(&ambiguous));
    }
}

#[test]
fn ambiguous_numbers_and_other_encodings_are_named() {
    let header = "tx_m,ty_m,tz_m,roll_rad,pitch_rad,yaw_rad";
    let semicolons = header.replace(',', ";");
    let utf16: Vec<u8> = header.encode_utf16().flat_map(u16::to_be_bytes).collect();
    for (input, told) in [
        (
            format!("{header}\n0,1,0,0,0,0,0\n").into_bytes(),
            ":2: 7 fields where the header has 6; numbers may have a decimal comma only if",
        ),
        (
            format!("{header}\n\"0,1\",0,0,0,0,0\n").into_bytes(),
            ":2: tx_m is \"0,1\": allowed is a finite number; a decimal comma only if",
        ),
        (
            format!("{semicolons}\n0,1;0;0;0;0;0.2\n").into_bytes(),
            ":2: yaw_rad is \"0.2\": allowed is a number with the decimal mark of the rows before, \",\"",
        ),
        (
            format!("{}\n1,234\t0\t0\t0\t0\t0\n", header.replace(',', "\t")).into_bytes(),
            ":2: tx_m is \"1,234\": allowed is a number with a clear decimal mark; this comma can be",
        ),
        (
            format!("{semicolons}\n0;-12,500;0;0;0;0,5\n").into_bytes(),
            ":2: ty_m is \"-12,500\": allowed is a number with a clear decimal mark; this comma can be",
        ),
        (format!("{header},beam_dx_m,beam_dx_m\n").into_bytes(), ":1: the column beam_dx_m occurs twice"),
        (
            format!("{semicolons}\n1.000,5;0;0;0;0;0\n").into_bytes(),
            ":2: tx_m is \"1.000,5\": allowed is a finite number without thousands",
        ),
        (
            format!("{}\n", header.replace(',', " ")).into_bytes(),
            ":1: the column tx_m is missing; required are tx_m",
        ),
        (
            format!("{}\n", header.replace(',', "|")).into_bytes(),
            "separated by commas, semicolons or tabs, but the first line is \"tx_m|ty_m",
        ),
        ([b"\xfe\xff", &utf16[..]].concat(), ":1:1: the text is in UTF-16"),
        (utf16.clone(), ":1:1: a zero byte: the text is in UTF-16"),
        (format!("{header}\r\n0,0,0,0\0,0,0\r\n").into_bytes(), ":2:8: a zero byte"),
        (
            [header.as_bytes(), b"\n0,0,0,0,\xb5,0\n"].concat(),
            ":2: pitch_rad contains the byte 0xb5, which is not UTF-8",
        ),
    ] {
        let output = trifacet(&["trace"], &input);
        assert_eq!(output.status.code(), Some(65), "{told}: {}", stderr(&output));
        assert!(stderr(&output).contains(told), "{told}: {}", stderr(&output));
    }
}

#[test]
fn an_invalid_row_is_reported_and_the_others_are_processed() {
    let rows = "tx_m,ty_m,tz_m,roll_rad,pitch_rad,yaw_rad\r\n\
                0,0,0,0,0,0\r\n\
                \r\n\
                0,zero,0,0,0,0\r\n\
                0,0,0\r\n\
                0,0,nan,0,0,0\r\n\
                0,0,0.05,0,0,0\r\n\
                0,0,0,0,0,1e-3";
    let output = trifacet(&["trace"], rows.as_bytes());
    assert_eq!(output.status.code(), Some(65));
    let told = stderr(&output);
    for line in [
        "standard input:4: ty_m is \"zero\": allowed is a finite number",
        "standard input:5: 3 fields where the header has 6",
        "standard input:6: tz_m is \"nan\": allowed is a finite number",
        "standard input:7: the light from facet A falls off its PSD",
        "standard input: 4 of 6 rows could not be processed",
    ] {
        assert!(told.contains(line), "{told}");
    }
    assert_eq!(told.lines().count(), 5, "{told}");
    let columns = columns(&output.stdout);
    for name in SPOTS.iter().chain(&POWERS) {
        let good: Vec<_> = columns[*name].iter().map(|cell| cell != "NaN").collect();
        assert_eq!(good, [true, false, false, false, false, true], "{name}");
    }
}

#[test]
fn solve_reports_why_there_is_no_pose() {
    let rows = "u_a_m,v_a_m,u_b_m,v_b_m,u_c_m,v_c_m,power_a,power_b,power_c\n\
                0,0,0,0,0,0,0.3,0.3,0.3\n\
                0,0,0,0,0,0,0.3,-0.3,0.3\n\
                0,0.007,0,0,0,0,0.3,0.3,0.3\n\
                0,0,0,0,0,0,0.3,0.3,inf\n";
    let output = trifacet(&["solve"], rows.as_bytes());
    assert_eq!(output.status.code(), Some(65));
    let solved = columns(&output.stdout);
    let status = &solved["status"];
    assert_eq!(status[0], "ok");
    assert!(status[1].contains("too little light on PSD B"), "{status:?}");
    assert!(status[2].contains("off PSD A"), "{status:?}");
    assert!(status[3].contains("power_c"), "{status:?}");
    for name in POSE.iter().chain(&OFFSET) {
        let known: Vec<_> = solved[*name].iter().map(|cell| cell != "NaN").collect();
        assert_eq!(known, [true, false, false, false], "{name}");
    }
    assert!(stderr(&output).contains("standard input:3: too little light on PSD B"));
}

#[test]
fn the_ray_model_needs_no_powers_and_the_gaussian_does() {
    let rows = b"u_a_m,v_a_m,u_b_m,v_b_m,u_c_m,v_c_m\n0,0,0,0,0,0\n";
    assert!(trifacet(&["solve", "--model", "ray"], rows).status.success());
    let output = trifacet(&["solve", "--model", "gaussian"], rows);
    assert_eq!(output.status.code(), Some(65));
    assert!(stderr(&output).contains("standard input:1: the column power_a is missing"));
}

#[test]
fn invalid_tables_are_refused() {
    let header = "tx_m,ty_m,tz_m,roll_rad,pitch_rad,yaw_rad";
    for (input, message) in [
        (String::new(), "standard input:1: empty: the first line must name the columns tx_m, ty_m"),
        ("\n\n".into(), "standard input:1: empty"),
        ("0,0,0,0,0,0\n".into(), "the column tx_m is missing; required are tx_m"),
        (format!("\n{header},tx_m\n"), "standard input:2: the column tx_m occurs twice"),
    ] {
        let output = trifacet(&["trace"], input.as_bytes());
        assert_eq!(output.status.code(), Some(65), "{input}");
        assert!(stderr(&output).contains(message), "{}", stderr(&output));
        assert!(output.stdout.is_empty());
    }
    let header_only = trifacet(&["trace"], format!("{header}\n").as_bytes());
    assert!(header_only.status.success());
    let output = trifacet(&["solve", "/no/such.csv"], b"");
    assert_eq!(output.status.code(), Some(74));
    assert!(stderr(&output).contains("cannot open /no/such.csv: No such file"), "{}", stderr(&output));
}

#[test]
fn a_reader_may_close_the_pipe_early_without_an_error() {
    let mut rows = String::from("tx_m,ty_m,tz_m,roll_rad,pitch_rad,yaw_rad\n");
    rows.push_str(&"0,0,0,0,0,0\n".repeat(20_000)); // more than a pipe holds
    let mut child = testkit::trifacet(&["trace"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let _ = child.stdin.take().unwrap().write_all(rows.as_bytes()); // it may end before the last row
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{:?}", output.status);
    assert_eq!(stderr(&output), "");
}

/// A command in a pipe whose other ends stay open.
fn live(command: &str) -> Child {
    testkit::trifacet(&[command])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

#[test]
fn every_row_is_answered_before_the_next_is_awaited() {
    let pose = "tx_m,ty_m,tz_m,roll_rad,pitch_rad,yaw_rad\n";
    let signals = "u_a_m,v_a_m,u_b_m,v_b_m,u_c_m,v_c_m,power_a,power_b,power_c\n";
    for (command, header, row) in [
        ("trace", pose, "1e-4,0,0,0,0,0\n"),
        ("trace", pose, "bad,0,0,0,0,0\n"),
        ("solve", signals, "0,0,0,0,0,0,0.3,0.3,0.3\n"),
    ] {
        let mut child = Killed(live(command));
        let mut stdin = child.0.stdin.take().unwrap();
        let stdout = BufReader::new(child.0.stdout.take().unwrap());
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || stdout.lines().map_while(Result::ok).try_for_each(|l| sender.send(l)));
        let next = || lines.recv_timeout(PATIENCE).expect("an answer while the input is open");
        stdin.write_all(header.as_bytes()).unwrap();
        assert!(next().starts_with(if command == "trace" { "u_a_m" } else { "tx_m" }));
        for _ in 0..3 {
            stdin.write_all(row.as_bytes()).unwrap();
            assert_eq!(next().contains("NaN"), row.contains("bad"), "{command} {row}");
        }
        drop(stdin);
        assert_eq!(child.0.wait().unwrap().code(), Some(if row.contains("bad") { 65 } else { 0 }));
    }
}

#[test]
fn a_reader_that_leaves_a_live_pipe_ends_the_command() {
    let mut child = Killed(live("trace"));
    drop(child.0.stdout.take());
    let mut stdin = child.0.stdin.take().unwrap();
    let _ = stdin.write_all(b"tx_m,ty_m,tz_m,roll_rad,pitch_rad,yaw_rad\n0,0,0,0,0,0\n");
    assert!(child.0.wait().unwrap().success(), "although the input is open");
}

/// Solves the frames of a table, and compares the poses with those of the table.
fn solved_as_published(frames: &str) {
    let output = trifacet(&["solve"], frames.as_bytes());
    assert!(output.status.success(), "{}", stderr(&output));
    // The signals of a frame have 24 bits.
    assert_near(&output.stdout, frames.as_bytes(), &POSE, 1e-8, "published");
}

#[test]
fn solve_reads_the_tables_of_watch_and_export() {
    let mut daemon = Daemon::start("");
    daemon.client().locked();
    let endpoint = format!("tcp://{}", daemon.address());
    let watched = run(&mut testkit::trifacet(&["watch", &endpoint, "--format", "csv", "--count", "20"]));
    solved_as_published(&watched.out);

    let home = Folder::new();
    let recording = home.path("twin.mcap");
    let config = home.write("twin.toml", "[[twin.fault]]\nat_s = 0.5\nkind = 'beam-blocked'");
    let simulate = ["simulate", "--closed-loop", "--samples", "1000", "--record"];
    let done = run(testkit::trifacet(&simulate).arg(&recording).arg("--config").arg(&config));
    assert_eq!(done.code, 0, "{}", done.err);
    for (what, unknown) in [("frames", "u_a_m is empty: the value is unknown"), ("samples", "empty")] {
        let table = on(&["export", "--format", "csv", "--output", "-", "--what", what], &recording).out;
        let output = trifacet(&["solve"], table.as_bytes());
        assert_eq!(output.status.code(), Some(65), "the blocked beam has no pose");
        assert!(stderr(&output).contains(unknown), "{what}: {}", stderr(&output));
        let good = columns(&output.stdout)["status"].iter().filter(|status| *status == "ok").count();
        assert!((400..600).contains(&good), "{what}: {good}");
    }
    let twice = "u_a_m,v_a_m,u_b_m,v_b_m,u_c_m,v_c_m,power_a,power_b,power_c,power_a_w\n";
    let output = trifacet(&["solve"], twice.as_bytes());
    assert!(stderr(&output).contains("the column power_a or power_a_w occurs twice"), "{}", stderr(&output));
}
