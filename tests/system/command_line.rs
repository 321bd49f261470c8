//! The command line: exit codes for supervisors and messages for operators.

use std::fs::File;
use std::process::Output;

use crate::testkit;

fn trifacet(arguments: &[&str]) -> Output {
    testkit::trifacet(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn wrong_command_lines_exit_64_and_show_what_is_allowed() {
    for (arguments, told) in [
        (&[][..], "Usage: trifacet"),
        (&["chekc"], "'check'"),
        (&["check", "--confg", "x"], "--config"),
        (&["trace", "--model", "wave"], "ray, gaussian"),
        (&["solve", "a.csv", "b.csv"], "unexpected argument"),
    ] {
        let output = trifacet(arguments);
        assert_eq!(output.status.code(), Some(64), "{arguments:?}");
        assert!(text(&output.stderr).contains(told), "{arguments:?}: {}", text(&output.stderr));
        assert!(output.stdout.is_empty());
    }
}

#[test]
fn help_and_version_go_to_standard_output() {
    let version = trifacet(&["--version"]);
    assert!(version.status.success());
    assert_eq!(text(&version.stdout), format!("trifacet {}\n", env!("CARGO_PKG_VERSION")));
    let help = text(&trifacet(&["--help"]).stdout);
    for word in ["check", "trace", "solve", "watch", "Exit codes", "78"] {
        assert!(help.contains(word), "{help}");
    }
}

#[test]
fn every_command_exits_78_for_an_invalid_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lab.toml");
    std::fs::write(&path, "[head]\npsd_distance_mm = -5\n\n[acquisition]\nrate_hz = 0\n").unwrap();
    let path = path.to_str().unwrap();
    for command in ["check", "trace", "solve", "simulate"] {
        let output = trifacet(&[command, "--config", path]);
        assert_eq!(output.status.code(), Some(78), "{command}");
        assert!(output.stdout.is_empty());
        assert_eq!(
            text(&output.stderr),
            format!(
                "trifacet: {path}:2:19: head.psd_distance_mm = -5: allowed is 5 to 10000\n\
                 trifacet: {path}:5:11: acquisition.rate_hz = 0: allowed is 1 to 20000\n"
            )
        );
    }
}

#[test]
fn a_number_out_of_range_is_named_with_its_option_and_what_is_allowed() {
    for (args, message) in [
        (
            &["ctl", "tare", "--poses", "0"][..],
            "'0' for '--poses <N>': allowed is 1 to the number of poses in 10 s",
        ),
        (&["experiment", "--out", "x", "--points", "2"], "'2' for '--points <N>': allowed is 3 to 10000"),
        (
            &["experiment", "--out", "x", "--average", "99999"],
            "'99999' for '--average <N>': allowed is 1 to 10000",
        ),
        (&["dark", "--samples", "0"], "'0' for '--samples <N>': allowed is 10 to 1000000"),
        (&["tune", "--steps", "1e3"], "'1e3' for '--steps <N>': allowed is 10 to 10000"),
        (&["watch", "--divider", "0"], "'0' for '--divider <DIVIDER>': allowed is 1 to 1000000"),
    ] {
        let output = trifacet(args);
        assert_eq!(output.status.code(), Some(64), "{args:?}");
        let told = text(&output.stderr);
        assert!(told.contains(message), "{told}");
    }
}

#[test]
fn a_configuration_that_cannot_be_read_exits_78_with_its_name() {
    for path in ["/no/such/lab.toml", "/"] {
        let output = trifacet(&["check", "--config", path]);
        assert_eq!(output.status.code(), Some(78));
        let told = text(&output.stderr);
        assert!(told.starts_with(&format!("trifacet: cannot read the configuration {path}: ")), "{told}");
    }
}

#[test]
fn check_explains_a_configuration() {
    let told = text(&trifacet(&["check"]).stdout);
    for part in [
        "PSDs of 13 mm at 250 mm, facets at 45 deg, beam 0.46 mm across",
        "A: u 0.0000 mm, v -0.1192 mm, 33.33 % of the beam",
        "digital twin",
        "1000 Hz",
        "Ki 200.0000 /s for a loop delay of 2.5 ms",
        // The standard uncertainties for 1.08 um of spot noise, as in Table 2 of the paper.
        "tx 0.986 ty 0.986 tz 0.624 um, roll 1.765 pitch 1.765 yaw 2.494 urad",
        "TCP at 127.0.0.1:7361",
        "UDP to 127.0.0.1:7362",
        "within +-400 um",
        "UNCALIBRATED",
    ] {
        assert!(told.contains(part), "{told}\ndoes not contain: {part}");
    }
}

#[test]
fn check_describes_the_stage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stage.toml");
    let told = |line: &str| {
        let gcs = "steering.kind = 'gcs'\ntwin.steering.readback_noise_um = 'off'\nsteering.gcs.zero_um = [50, 50]\n";
        std::fs::write(&path, format!("{gcs}steering.limit_um = 45\nsteering.lease_ms = 10\n{line}"))
            .unwrap();
        text(&trifacet(&["check", "--config", path.to_str().unwrap()]).stdout)
    };
    let stage = "axes 1 and 2 in units of 1 um, zero at [50.0, 50.0] um, within +-45 um, at most 50 mm/s";
    let tcp = told("steering.gcs.address = 'stage:50000'");
    assert!(tcp.contains(&format!("PI stage (GCS 2.0) at stage:50000, {stage}")), "{tcp}");
    assert!(tcp.contains("it has no lease") && !tcp.contains("lease_ms"), "{tcp}");
    let serial = told("steering.gcs.port = '/dev/ttyUSB3'");
    assert!(
        serial.contains(&format!("PI stage (GCS 2.0) at /dev/ttyUSB3, 115200 baud, {stage}")),
        "{serial}"
    );
}

#[test]
fn check_warns_of_unusual_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("slow.toml");
    std::fs::write(&path, "acquisition.rate_hz = 10\nestimation.average = 4\n").unwrap();
    let told = text(&trifacet(&["check", "--config", path.to_str().unwrap()]).stdout);
    assert!(told.contains("steering.lease_ms = 200 is short"), "{told}");
    assert!(told.contains("two periods are used"), "{told}");
    assert!(told.contains("means of 4 samples") && told.contains("2.5 frames per second"), "{told}");
    // The mean of four samples halves the standard uncertainties.
    assert!(told.contains("tx 0.493"), "{told}");
}

#[test]
fn a_full_disk_exits_74() {
    let full = File::create("/dev/full").unwrap();
    let output = testkit::trifacet(&["check"]).stdout(full).output().unwrap();
    assert_eq!(output.status.code(), Some(74));
    assert!(text(&output.stderr).contains("cannot write to standard output: No space left"));
}
