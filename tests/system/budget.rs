//! `trifacet budget` through the binary: formats, errors, and two other programs that compute the same budget.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::testkit::{Folder, on, run, trifacet, venv};

/// A configuration that states every effect, with an arm, a difference amplifier and a finite number of degrees of
/// freedom.
const STATED: &str = "\
laser.power_uw = 600
channels.b.amplifier = 'difference'
frames.tool.translation_mm = [0, 0, -50]
[estimation]
systematic_um = [0.1, 0.12, 0.14]
systematic_urad = [0.3, 0.3, 0.4]
[uncertainty]
tare_readings = 25
noise_dof = 12
temperature_range_k = 0.5
height_difference_mm = 50
pointing_urad = 1
reference_scale_ppm = 50
reference_angle_ppm = 80
reference_squareness_urad = 20
lever_arm_um = 20
dark_mv = 5
";
const POSE: &str = "--pose=800,-300,200,500,4000,-100";

/// The configuration with all effects, on the disk.
fn stated(folder: &Folder) -> PathBuf {
    folder.write("stated.toml", STATED)
}

/// The output of a budget that must succeed.
fn output(config: &Path, options: &[&str]) -> String {
    let mut arguments = vec!["budget", "--config", config.to_str().unwrap()];
    arguments.extend(options);
    let done = run(&mut trifacet(&arguments));
    assert_eq!(done.code, 0, "{}", done.err);
    done.out
}

fn json(config: &Path, options: &[&str]) -> Value {
    serde_json::from_str(&output(config, &[options, &["--format", "json"]].concat())).unwrap()
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("{key} of {value}"))
}

/// A text without its line breaks.
fn words(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn each(value: &Value) -> &[Value] {
    value.as_array().unwrap()
}

#[test]
fn shares_add_up_and_the_expanded_uncertainty_is_k_times_the_combined_one() {
    let folder = Folder::new();
    let budget = json(&stated(&folder), &[POSE, "--trials", "0", "--average", "4"]);
    assert!(each(&budget["not_covered"]).is_empty(), "{}", budget["not_covered"]);
    for (j, measurand) in each(&budget["measurands"]).iter().enumerate() {
        let (u, k) = (number(measurand, "u_c"), number(measurand, "k"));
        let (mut variance, mut shares, mut satterthwaite) =
            (0.0, number(measurand, "correlation_share"), 0.0);
        for input in each(&budget["inputs"]) {
            let contribution = input["contribution"][j].as_f64().unwrap();
            let product = input["sensitivity"][j].as_f64().unwrap() * number(input, "u");
            assert!((product - contribution).abs() <= 1e-12 * u, "{input}");
            variance += contribution.powi(2);
            shares += input["share"][j].as_f64().unwrap();
            if let Some(dof) = input["dof"].as_f64() {
                satterthwaite += contribution.powi(4) / dof;
            }
        }
        assert!((variance.sqrt() / u - 1.0).abs() < 1e-9 && (shares - 1.0).abs() < 1e-9);
        let dof = number(measurand, "nu_eff");
        assert!((dof * satterthwaite / u.powi(4) - 1.0).abs() < 1e-9 && dof > 12.0, "{dof}");
        assert!((number(measurand, "U") / (k * u) - 1.0).abs() < 1e-12 && k > 2.0 && k < 2.3, "{k}");
    }
    // Four times the samples halve the noise of the pose, not that of the tare.
    let noise = |average: &str| {
        let budget = json(&stated(&folder), &[POSE, "--trials", "0", "--average", average]);
        let of =
            |group: &str| number(each(&budget["inputs"]).iter().find(|i| i["group"] == group).unwrap(), "u");
        [of("spot noise, pose"), of("spot noise, tare")]
    };
    let (one, four) = (noise("1"), noise("4"));
    assert!((one[0] - 1.08).abs() < 1e-9 && (four[0] - 0.54).abs() < 1e-9 && (one[1] - 0.216).abs() < 1e-9);
    assert_eq!(one[1], four[1]);
}

#[test]
fn the_monte_carlo_method_agrees_and_repeats() {
    let folder = Folder::new();
    let config = stated(&folder);
    let options = [POSE, "--trials", "20000", "--seed", "7"];
    let budget = json(&config, &options);
    assert_eq!(budget, json(&config, &options), "the same seed gives the same numbers");
    for measurand in each(&budget["measurands"]) {
        let (trials, u) = (&measurand["monte_carlo"], number(measurand, "u_c"));
        // The noise is drawn from t-distributions with 12 degrees of freedom: wider by the root of 12/10.
        let ratio = number(trials, "u") / u;
        assert!((0.97..1.12).contains(&ratio), "{measurand}");
        assert!((number(trials, "mean") - number(measurand, "value")).abs() < 0.05 * u, "{measurand}");
        let ends = each(&trials["interval"]).iter().map(|end| end.as_f64().unwrap()).collect::<Vec<_>>();
        let half = (ends[1] - ends[0]) / 2.0;
        assert!((half / number(measurand, "U") - 1.0).abs() < 0.1, "{measurand}");
        assert!(["yes", "no", "undecided"].contains(&trials["validated"].as_str().unwrap()));
        assert_eq!((trials["trials"].as_u64(), trials["failed"].as_u64()), (Some(20_000), Some(0)));
    }
    // Without degrees of freedom, everything is nearly normal: what 200 000 trials can decide is validated.
    let normal =
        folder.write("normal.toml", "uncertainty.temperature_range_k = 0\nuncertainty.pointing_urad = 0\n");
    let budget = json(&normal, &["--pose=0,0,0,0,0,0", "--trials", "200000"]);
    for measurand in each(&budget["measurands"]) {
        assert_ne!(measurand["monte_carlo"]["validated"], "no", "{measurand}");
    }
}

#[test]
fn a_head_that_is_not_calibrated_is_called_so_and_effects_that_are_not_stated_are_named() {
    let folder = Folder::new();
    let bare = folder.write("bare.toml", "");
    let text = output(&bare, &[POSE, "--trials", "0"]);
    assert!(text.contains("THE HEAD IS NOT CALIBRATED"), "{text}");
    for key in ["temperature_range_k", "pointing_urad", "reference_scale_ppm", "reference_squareness_urad"] {
        assert!(text.contains(&format!("(uncertainty.{key} is not set)")), "{key}: {text}");
    }
    let text = words(&output(&stated(&folder), &[POSE, "--trials", "0"]));
    assert!(!text.contains("NOT CALIBRATED") && !text.contains("Not covered"), "{text}");
    assert!(text.contains("Not calibrated: the configuration names no calibration record (calibration.record). estimation.systematic_um"), "{text}");
    let serial = folder
        .write("serial.toml", "acquisition.source = 'serial'\nframes.tool.translation_mm = [1, 0, 0]\n");
    let text = words(&output(&serial, &[POSE, "--trials", "0"]));
    assert!(
        text.contains(
            "resolution of the converter (uncertainty.converter_bits or converter_range_v is not set)"
        ),
        "{text}"
    );
    assert!(text.contains("lever arm of frames.tool (uncertainty.lever_arm_um is not set)"), "{text}");
}

#[test]
fn the_text_fits_a_hundred_columns_and_states_two_digits() {
    let folder = Folder::new();
    let text = output(&stated(&folder), &["--range", "1,4", "--trials", "1000"]);
    let long: Vec<_> = text.lines().filter(|line| line.chars().count() > 100).collect();
    assert!(long.is_empty(), "{long:#?}");
    for title in [
        "Input quantities",
        "Sensitivities",
        "Contributions",
        "Shares",
        "Combined",
        "Correlation",
        "Monte Carlo",
        "Largest standard",
        "Verdict",
    ] {
        assert!(text.lines().any(|line| line.starts_with(title)), "{title}: {text}");
    }
    let u_c = text.lines().find(|line| line.starts_with("u_c,")).unwrap();
    for number in u_c.split_whitespace().skip(3) {
        let digits = number.trim_start_matches(['0', '.']).chars().filter(char::is_ascii_digit).count();
        assert_eq!(digits, 2, "{u_c}");
    }
    assert!(
        text.lines().any(|line| line.starts_with("sum ") && line.matches("100.0").count() == 6),
        "{text}"
    );
}

#[test]
fn the_worst_pose_of_a_range_is_not_better_than_any_of_its_corners() {
    let folder = Folder::new();
    let config = stated(&folder);
    let range = json(&config, &["--range", "1,4", "--trials", "0"]);
    for (j, largest) in each(&range["range"]["largest"]).iter().enumerate() {
        let u = number(largest, "u_c");
        for pose in [
            "--pose=1000,1000,1000,4000,4000,4000",
            "--pose=-1000,1000,-1000,4000,-4000,4000",
            "--pose=0,0,0,0,0,0",
        ] {
            let here = number(&json(&config, &[pose, "--trials", "0"])["measurands"][j], "u_c");
            assert!(here <= u * (1.0 + 1e-9), "{pose}: {here}, {largest}");
        }
        let pose: Vec<_> = each(&largest["pose"]).iter().map(|x| x.as_f64().unwrap().to_string()).collect();
        let there = json(&config, &[&format!("--pose={}", pose.join(",")), "--trials", "0"]);
        assert!((number(&there["measurands"][j], "u_c") / u - 1.0).abs() < 1e-6, "{largest}");
    }
}

#[test]
fn csv_and_html_contain_the_same_numbers_as_json() {
    let folder = Folder::new();
    let config = stated(&folder);
    let budget = json(&config, &[POSE, "--trials", "0"]);
    let table = output(&config, &[POSE, "--format", "csv"]);
    let mut reader = csv::Reader::from_reader(table.as_bytes());
    let columns = reader.headers().unwrap().clone();
    let place = |name: &str| columns.iter().position(|column| column == name).unwrap();
    let mut combined = 0;
    for record in reader.records().map(Result::unwrap) {
        if &record[place("quantity")] == "combined" {
            let measurand = &budget["measurands"][combined];
            assert_eq!(measurand["name"], record[place("measurand")]);
            for (column, key) in [("u", "u_c"), ("expanded", "U")] {
                let ratio = record[place(column)].parse::<f64>().unwrap() / number(measurand, key);
                assert!((ratio - 1.0).abs() < 1e-12, "{column}: {record:?}");
            }
            combined += 1;
        }
    }
    assert_eq!(combined, 6);
    let page = output(&config, &[POSE, "--trials", "1000", "--format", "html"]);
    assert!(page.starts_with("<!DOCTYPE html>") && page.contains("size: A4"), "{page}");
    for needed in [
        "Input quantities",
        "uncertainty.psd_zero_ppm_per_k, +-0.5 K",
        "correlations",
        "Monte Carlo",
        "Signed",
    ] {
        assert!(page.contains(needed), "{needed}: {page}");
    }
    assert!(!page.contains("http") && !page.contains("<script"), "no external resource, no script");
}

#[test]
fn wrong_options_and_poses_are_refused_with_what_is_allowed() {
    let folder = Folder::new();
    let bare = folder.write("bare.toml", "");
    let path = bare.to_str().unwrap();
    for (options, code, message) in [
        (&["--pose", "1,2,3"][..], 64, "allowed is six numbers"),
        (&["--pose", "1,2,3,4,5,x"], 64, "allowed is six numbers"),
        (&["--pose", "0,0,0,0,0,nan"], 64, "allowed is six numbers"),
        (&["--pose", "0,0,0,0,0,2e6"], 64, "allowed is -1000000 to 1000000, each"),
        (&["--range", "1"], 64, "allowed is two numbers"),
        (&["--range", "-1,5"], 64, "allowed is 0 to 1000, each"),
        (&["--pose", "0,0,0,0,0,0", "--range", "1,5"], 64, "cannot be used with"),
        (&["--average", "0"], 64, "allowed is 1 to 1000000000"),
        (&["--probability", "95"], 64, "allowed is 0.5 to 0.9999"),
        (&["--trials", "10"], 64, "allowed is 0, or 1000 to 10000000"),
        (
            &["--pose", "9000,0,0,0,0,0"],
            65,
            "the pose 9000 0 0 um, 0 0 0 urad is outside the range of the sensor: the light from facet B falls off its PSD",
        ),
        (&["--range", "5,50"], 65, "is outside the range of the sensor"),
    ] {
        let done = run(&mut trifacet(&[&["budget", "--config", path], options].concat()));
        assert_eq!(done.code, code, "{options:?}: {}", done.err);
        assert!(done.err.contains(message), "{options:?}: {}", done.err);
        assert!(done.out.is_empty(), "{}", done.out);
    }
    for (text, message) in [
        ("uncertainty.pointing_urad = -1", "uncertainty.pointing_urad = -1: allowed is 0 to 100000"),
        ("uncertainty.pointing = 1", "did you mean pointing_urad?"),
        ("frames.tare.translation_mm = [900, 0, 0]", "the tare pose is outside the range of the sensor"),
    ] {
        let done = on(&["budget", "--config"], &folder.write("wrong.toml", text));
        assert_eq!(done.code, 78, "{}", done.err);
        assert!(done.err.contains(message), "{}", done.err);
    }
}

/// Python with both packages. Later versions of suncal need Python 3.12.
fn python() -> PathBuf {
    venv::python("budget-venv", "GTC, suncal", &["GTC==1.5.1", "suncal==1.6.5"])
}

/// Both agree with our number to this, relatively: four digits and one more.
const AGREE: f64 = 1e-5;

#[test]
fn gtc_computes_the_same_budget() {
    let folder = Folder::new();
    let config = stated(&folder);
    let script = folder.write("budget.py", output(&config, &[POSE, "--format", "gtc"]));
    let budget = json(&config, &[POSE, "--trials", "0"]);
    let printed = venv::succeeded(Command::new(python()).arg(&script), "the script for GTC");
    let printed = String::from_utf8(printed.stdout).unwrap();
    let mut lines = printed.lines().skip(1);
    for measurand in each(&budget["measurands"]) {
        let line: Vec<_> = lines.next().unwrap().split(' ').collect();
        assert_eq!((measurand["name"].as_str(), measurand["unit"].as_str()), (Some(line[0]), Some(line[1])));
        for (key, text) in ["u_c", "nu_eff", "k", "U", "U"].into_iter().zip(&line[2..]) {
            let (ours, theirs) = (number(measurand, key), text.parse::<f64>().unwrap());
            assert!((theirs / ours - 1.0).abs() < AGREE, "{key} of {measurand}: GTC has {theirs}");
        }
    }
    assert_eq!(lines.next(), Some("correlation"));
    for row in each(&budget["correlation"]) {
        for (ours, theirs) in each(row).iter().zip(lines.next().unwrap().split(' ')) {
            let (ours, theirs) = (ours.as_f64().unwrap(), theirs.parse::<f64>().unwrap());
            assert!((ours - theirs).abs() < AGREE, "{ours}: GTC has {theirs}");
        }
    }
}

#[test]
fn suncal_computes_the_same_budget() {
    let folder = Folder::new();
    let config = stated(&folder);
    let project = folder.write("budget.yaml", output(&config, &[POSE, "--format", "suncal"]));
    let budget = json(&config, &[POSE, "--trials", "0"]);
    let script = "import sys\nfrom suncal.project import Project\n\
        for item in Project.from_configfile(sys.argv[1]).items:\n\
        \x20   gum, name = item.calculate(mc=False).gum, item.name\n\
        \x20   print(name, float(gum.expected[name]), float(gum.uncertainty[name]), float(gum.degf[name]))\n";
    let printed = venv::succeeded(Command::new(python()).args(["-c", script]).arg(&project), "suncal");
    let printed = String::from_utf8(printed.stdout).unwrap();
    let lines: Vec<Vec<_>> = printed.lines().map(|line| line.split(' ').collect()).collect();
    assert_eq!(lines.len(), 6, "{printed}");
    for (measurand, line) in each(&budget["measurands"]).iter().zip(lines) {
        assert_eq!(measurand["name"], line[0]);
        for (key, text) in ["value", "u_c", "nu_eff"].into_iter().zip(&line[1..]) {
            let (ours, theirs) = (number(measurand, key), text.parse::<f64>().unwrap());
            assert!((theirs / ours - 1.0).abs() < AGREE, "{key} of {measurand}: suncal has {theirs}");
        }
    }
}
