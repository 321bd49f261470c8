//! `calibrate fit` through the binary: a calibrated head, what is refused and named, and that nothing is written over.

use std::fs;
use std::path::{Path, PathBuf};

use crate::testkit::{Done, Folder, computing, run, trifacet};

fn reference(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference/calibration").join(name)
}

/// Fits these tables in a folder with a configuration `in.toml`; the results go to `out`.
fn fit(folder: &Folder, points: &Path, options: &[&str]) -> Done {
    let config = folder.path("in.toml");
    if !config.exists() {
        fs::write(&config, "# my rig\n[log]\nlevel = \"warn\" # quiet").unwrap();
    }
    let (config, points, out) = (text(&config), text(points), text(&folder.path("out")));
    let fit = ["calibrate", "fit", "--config", &config, "--points", &points, "--out", &out];
    computing(&[&fit, options].concat())
}

fn text(path: &Path) -> String {
    path.to_str().unwrap().into()
}

fn numbers(csv: &str, names: &[&str]) -> Vec<Vec<f64>> {
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    let header = reader.headers().unwrap().clone();
    let places: Vec<usize> =
        names.iter().map(|name| header.iter().position(|h| h == *name).unwrap()).collect();
    let row = |record: csv::StringRecord| places.iter().map(|i| record[*i].parse().unwrap()).collect();
    reader.records().map(|record| row(record.unwrap())).collect()
}

const POSE: [&str; 6] = ["tx_m", "ty_m", "tz_m", "roll_rad", "pitch_rad", "yaw_rad"];

#[test]
fn a_fit_writes_a_configuration_that_gives_the_true_poses() {
    let folder = Folder::new();
    let scan = reference("mild.scan.csv");
    let options = ["--scan", scan.to_str().unwrap(), "--want-um", "0.2", "--want-urad", "0.5"];
    let output = fit(&folder, &reference("mild.points.csv"), &options);
    assert_eq!(output.code, 0, "{}", output.err);
    assert!(output.err.contains("calibrated: over +-1 mm and +-5 mrad"), "{}", output.err);
    let out = folder.path("out");
    let text = fs::read_to_string(out.join("trifacet.toml")).unwrap();
    assert!(text.starts_with("# my rig\n[log]\nlevel = \"warn\" # quiet\n"), "{text}");

    let mut solve = trifacet(&["solve", "--readings", "--frames", "--tare-row", "1", "--sigma", "--config"]);
    let solved = run(solve.arg(out.join("trifacet.toml")).arg(reference("mild.test.csv")));
    assert_eq!(solved.code, 0, "{}", solved.err);
    let found = numbers(&solved.out, &POSE);
    let stated =
        numbers(&solved.out, &POSE.map(|name| format!("cal_std_{name}")).each_ref().map(String::as_str));
    let wanted = numbers(&fs::read_to_string(reference("mild.test.csv")).unwrap(), &POSE);
    let figures = |rows: std::ops::Range<usize>, axes: std::ops::Range<usize>| {
        let errors: Vec<f64> = rows
            .flat_map(|k| axes.clone().map(move |i| (k, i)))
            .map(|(k, i)| found[k][i] - wanted[k][i])
            .collect();
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        (rms, errors.iter().fold(0.0_f64, |a, e| a.max(e.abs())))
    };
    let n = wanted.len();
    let (near_m, near_rad) = (figures(1..101, 0..3), figures(1..101, 3..6));
    let (far_m, far_rad) = (figures(101..n, 0..3), figures(101..n, 3..6));
    assert!(near_m.0 <= 0.04e-6 && near_rad.0 <= 0.10e-6, "{near_m:?} {near_rad:?}");
    assert!(far_m.0 <= 0.13e-6 && far_rad.0 <= 0.32e-6, "{far_m:?} {far_rad:?}");
    let held = (101..n).flat_map(|k| (0..6).map(move |i| (k, i)));
    let held = held.filter(|(k, i)| (found[*k][*i] - wanted[*k][*i]).abs() <= 1.96 * stated[*k][*i]).count();
    let held = held as f64 / (6 * (n - 101)) as f64;
    assert!((0.93..=0.995).contains(&held), "{held}");
    assert_eq!(stated[0], [0.0; 6]);
    assert!(far_m.1 <= 0.7e-6 && far_rad.1 <= 1.7e-6, "{far_m:?} {far_rad:?}");

    let mut check = trifacet(&["check", "--config"]);
    assert_eq!(run(check.arg(out.join("trifacet.toml"))).code, 0);

    let report: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(report["dropped"], serde_json::json!([]));
    let per_row = report["chi2_per_row"].as_f64().unwrap();
    assert!((0.7..=1.1).contains(&per_row), "{per_row}");
    assert!(report["verdict"].as_str().unwrap().starts_with("calibrated: "));
    assert!(report["before"]["um"][0].as_f64().unwrap() > 10.0 * report["after"]["um"][0].as_f64().unwrap());
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("Rows that were dropped") && !page.contains("<script"));
    // Nine pictures of errors, three of coverage; a bar for each parameter.
    assert_eq!(page.matches("<figure>").count(), 12);
    assert_eq!(page.matches("class=\"bar\"").count(), report["parameters"].as_array().unwrap().len());
    let determined = |name: &str| {
        let parameters = report["parameters"].as_array().unwrap();
        let own = parameters.iter().find(|p| p["name"] == name).unwrap();
        own["determined_by"].as_str().unwrap().to_owned()
    };
    assert_eq!(determined("psd_b.ln_power_gain"), "data");
    assert_eq!(determined("psd_a.position_u"), "convention");
    for parameter in report["parameters"].as_array().unwrap() {
        let parts = parameter["shares"].as_object().unwrap().values().map(|part| part.as_f64().unwrap());
        assert!((parts.sum::<f64>() - 1.0).abs() < 1e-9, "{parameter}");
    }
    let held_out = report["held_out_poses"].as_array().unwrap();
    assert_eq!(held_out.len() as u64, report["held_out"]["poses"].as_u64().unwrap());
    assert!(held_out.len() > 40 && held_out.iter().all(|pose| pose["line"].as_u64().unwrap() >= 2));
    // The errors along each axis are those of the table.
    let squares = held_out.iter().map(|pose| pose["error"][0].as_f64().unwrap().powi(2));
    let rms = (squares.sum::<f64>() / held_out.len() as f64).sqrt();
    assert!((rms / report["after"]["um"][0].as_f64().unwrap() - 1.0).abs() < 1e-9, "{rms}");

    // Nothing is written over: refused before anything is read.
    let again = fit(&folder, Path::new("absent.csv"), &[]);
    assert_eq!(again.code, 74);
    assert!(again.err.contains("psd-a.csv exists already: choose another folder"), "{}", again.err);
}

/// The points of the mild head, changed row by row; `header` has the names of the columns.
fn changed(folder: &Folder, change: impl Fn(&[String], &mut Vec<String>)) -> PathBuf {
    let text = fs::read_to_string(reference("mild.points.csv")).unwrap();
    let mut lines = text.lines();
    let header: Vec<String> = lines.next().unwrap().split(',').map(str::to_owned).collect();
    let mut new = header.join(",") + "\n";
    for line in lines {
        let mut fields: Vec<String> = line.split(',').map(str::to_owned).collect();
        change(&header, &mut fields);
        new += &(fields.join(",") + "\n");
    }
    let path = folder.path("changed.csv");
    fs::write(&path, new).unwrap();
    path
}

fn assert_refused(change: impl Fn(&[String], &mut Vec<String>), options: &[&str], reason: &str) {
    let folder = Folder::new();
    let points = changed(&folder, change);
    let output = fit(&folder, &points, options);
    assert_eq!(output.code, 65, "{}", output.err);
    assert!(output.err.contains(reason), "{}", output.err);
    assert!(!folder.path("out").exists());
}

fn scale(header: &[String], fields: &mut [String], names: &[&str], by: f64) {
    for name in names {
        let i = header.iter().position(|h| h == name).unwrap();
        fields[i] = (fields[i].parse::<f64>().unwrap() * by).to_string();
    }
}

#[test]
fn plain_mistakes_are_refused_by_name() {
    let angles = ["ref_roll_rad", "ref_pitch_rad", "ref_yaw_rad"];
    assert_refused(
        |header, fields| scale(header, fields, &["ref_ty_m"], -1.0),
        &[],
        "the sign of ref_ty is reversed",
    );
    assert_refused(
        |header, fields| scale(header, fields, &["ref_tx_m", "ref_ty_m", "ref_tz_m"], 1.0 / 25.4),
        &[],
        "in inches where millimetres are meant",
    );
    assert_refused(
        |header, fields| scale(header, fields, &angles, 180.0 / std::f64::consts::PI),
        &[],
        "in degrees instead of radians",
    );
    assert_refused(
        |header, fields| {
            for name in ["u", "v", "power"] {
                let place = |psd: &str| {
                    let unit = if name == "power" { "" } else { "_m" };
                    header.iter().position(|h| *h == format!("{name}_{psd}{unit}")).unwrap()
                };
                fields.swap(place("b"), place("c"));
            }
        },
        &[],
        "PSDs B and C are exchanged",
    );
}

#[test]
fn a_laser_that_drifts_more_than_the_readback_states_is_named() {
    // The direction of the laser wanders by 20 um at the apex, slowly.
    let drift = |header: &[String], fields: &mut Vec<String>, row: f64| {
        for (name, phase) in [("stage_x_m", 0.0), ("stage_y_m", 1.0)] {
            let i = header.iter().position(|h| h == name).unwrap();
            let moved = fields[i].parse::<f64>().unwrap() + 20e-6 * (row / 40.0 + phase).sin();
            fields[i] = moved.to_string();
        }
    };
    let row = std::cell::Cell::new(0.0);
    let drifting = |header: &[String], fields: &mut Vec<String>| {
        row.set(row.get() + 1.0);
        drift(header, fields, row.get());
    };
    assert_refused(drifting, &[], "the direction of the laser drifted during the measurement");
}

#[test]
fn several_tables_have_one_zero_unless_they_state_another() {
    let folder = Folder::new();
    let table = fs::read_to_string(reference("mild.points.csv")).unwrap();
    let (header, rows) = table.split_once('\n').unwrap();
    let header = header.trim_end();
    let rows: Vec<&str> = rows.lines().step_by(4).collect(); // each fit takes seconds
    let (first, second) = rows.split_at(rows.len() / 2);
    // The reference was set to zero again, 30 um beside, before the second half.
    let column = header.split(',').position(|name| name == "ref_tx_m").unwrap();
    let moved = |row: &&str| {
        let mut fields: Vec<String> = row.split(',').map(str::to_owned).collect();
        fields[column] = (fields[column].parse::<f64>().unwrap() + 30e-6).to_string();
        fields.join(",")
    };
    let save = |name: &str, header: &str, rows: Vec<String>| {
        let path = folder.path(name);
        fs::write(&path, format!("{header}\n{}\n", rows.join("\n"))).unwrap();
        path
    };
    let plain = |rows: &[&str]| rows.iter().map(|row| (*row).to_owned()).collect::<Vec<_>>();
    let first = save("first.csv", header, plain(first));
    let same = save("same.csv", header, plain(second));
    let other = save("other.csv", header, second.iter().map(moved).collect());
    let named = second.iter().map(|row| moved(row) + ",after lunch").collect();
    let named = save("named.csv", &format!("{header},run"), named);

    fs::write(folder.path("in.toml"), "").unwrap();
    let fit = |second: &Path, options: &[&str], out: &str| {
        let [config, first, second, out] =
            [&folder.path("in.toml"), &first, second, &folder.path(out)].map(text);
        let fit =
            ["calibrate", "fit", "--config", &config, "--points", &first, "--points", &second, "--out", &out];
        computing(&[&fit, options].concat())
    };
    let common = fit(&same, &[], "common");
    assert_eq!(common.code, 0, "{}", common.err);
    let shifted = fit(&other, &[], "shifted");
    assert_eq!(shifted.code, 65, "{}", shifted.err);
    for (second, options, out) in [(&other, &["--own-zero"][..], "own"), (&named, &[], "named")] {
        let done = fit(second, options, out);
        assert_eq!(done.code, 0, "{out}: {}", done.err);
        let report = fs::read_to_string(folder.path(out).join("report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_str(&report).unwrap();
        assert_eq!(report["inputs"].as_array().unwrap().len(), 2);
        assert_eq!(report["dropped"], serde_json::json!([]));
    }
}

#[test]
fn data_that_cannot_carry_what_is_asked_are_refused_by_name() {
    let without = |names: &'static [&'static str]| {
        move |header: &[String], fields: &mut Vec<String>| {
            for (name, field) in header.iter().zip(fields) {
                if names.iter().any(|part| name.starts_with("ref_") && name.contains(part)) {
                    *field = "NaN".into();
                }
            }
        }
    };
    assert_refused(without(&["_m", "_rad"]), &["--want-um", "0.5"], "free motion only");
    assert_refused(without(&["_rad"]), &["--want-urad", "0.5"], "translations only");
}

#[test]
fn a_bad_row_is_named_by_file_line_and_column() {
    let row = "0.001,0,0,0,0,0,2e-4,2e-4,2e-4,0.001,NaN\n";
    let header = "u_a_m,v_a_m,u_b_m,v_b_m,u_c_m,v_c_m,power_a,power_b,power_c,ref_tx_m,ref_std_tx_m\n";
    let folder = Folder::new();
    let points = folder.path("points.csv");
    fs::write(&points, [header, row].concat()).unwrap();
    let output = fit(&folder, &points, &[]);
    assert_eq!(output.code, 65);
    assert!(output.err.contains("points.csv:2: ref_tx_m has a value, but ref_std_tx_m does not"));
    fs::write(&points, [header, &row.replace("0.001,0,0", "12,0,0")].concat()).unwrap();
    let output = fit(&folder, &points, &[]);
    assert!(output.err.contains("points.csv:2: u_a_m is \"12\": allowed is"), "{}", output.err);
}

#[test]
fn tolerances_out_of_range_are_named() {
    let folder = Folder::new();
    let file = folder.path("tolerances.toml");
    let options = ["--tolerances", file.to_str().unwrap()];
    fs::write(&file, "psd_position_mm = 0.0\n").unwrap();
    let output = fit(&folder, &reference("mild.points.csv"), &options);
    assert_eq!(output.code, 78);
    assert!(output.err.contains("psd_position_mm is 0: allowed is"), "{}", output.err);
    fs::write(&file, "psd_distance = 1.0\n").unwrap();
    let output = fit(&folder, &reference("mild.points.csv"), &options);
    assert_eq!(output.code, 78);
    assert!(output.err.contains("psd_distance"), "{}", output.err);
}
