//! The experiment on the twin, compared with the numbers of the paper for ten seeds.

use std::collections::BTreeMap;
use std::fs;

use super::{AXES, deviation, done, median, number, points, rows, run, table2};

/// The median of the standard deviations of fifty readings is smaller than their true standard deviation, by
/// the factor sqrt(m / 49), where m is the median of chi-square with 49 degrees of freedom.
const MEDIAN: f64 = 1.0 - 0.0068;

#[test]
fn ten_seeds_agree_with_the_table_of_the_paper_and_their_mean_with_the_prediction() {
    let mut pooled = BTreeMap::<String, [f64; 2]>::new();
    for seed in 1..=10 {
        let (_folder, out) = done(&["--seed", &seed.to_string(), "--paper-only", "--rest", "0"]);
        for (axis, [measured, paper, predicted]) in table2(&out) {
            assert!((measured / paper - 1.0).abs() < 0.15, "seed {seed}: {axis} {measured}, paper {paper}");
            let sum = pooled.entry(axis).or_default();
            *sum = [sum[0] + measured / 10.0, sum[1] + predicted / 10.0];
        }
    }
    assert_eq!(pooled.len(), 6);
    for (axis, [measured, predicted]) in pooled {
        let ratio = measured / (predicted * MEDIAN);
        assert!((ratio - 1.0).abs() < 0.03, "{axis}: {measured}, predicted {predicted}: {ratio}");
    }
}

#[test]
fn the_table_follows_from_the_readings_and_the_noise_beyond_the_paper_is_lower() {
    let (_folder, out) = done(&["--seed", "4", "--rest", "2"]);
    let text = fs::read_to_string(out.join("table2.csv")).unwrap();
    assert!(text.starts_with("axis,unit,measured_std,paper_std,predicted_std\ntx,um,"), "{text}");
    let units: Vec<_> =
        rows(&out.join("table2.csv")).iter().map(|r| (r["axis"].clone(), r["unit"].clone())).collect();
    assert_eq!(units.iter().map(|(axis, _)| axis.as_str()).collect::<Vec<_>>(), AXES);
    assert!(units[3..].iter().all(|(_, unit)| unit == "urad"));
    // 1.08 um of noise through the linearised model with the geometry of the paper.
    let theory = [0.986, 0.986, 0.623, 1.764, 1.764, 2.494];
    for (axis, theory) in AXES.iter().zip(theory) {
        let [measured, paper, predicted] = table2(&out)[*axis];
        let all = points(&out, "table2", axis);
        assert_eq!((all.len(), all.iter().map(Vec::len).sum::<usize>()), (21, 1050));
        let own = median(all.iter().map(|point| deviation(point)).collect());
        assert!((own / measured - 1.0).abs() < 1e-9, "{axis}: {own} {measured}");
        assert!((predicted / theory - 1.0).abs() < 0.005, "{axis}: {predicted} {theory}");

        let beyond = median(points(&out, "beyond", axis).iter().map(|point| deviation(point)).collect());
        let quieter = predicted * (0.57 / 1.08) / 10.0;
        assert!((beyond / quieter - 1.0).abs() < 0.15, "{axis}: {beyond} {quieter}");
        assert!(beyond < paper / 15.0);
    }
}

#[test]
fn the_readings_agree_with_the_references() {
    let (_folder, out) = done(&[
        "--axes",
        "ty,roll",
        "--points",
        "5",
        "--interval",
        "roll=100",
        "--readings",
        "400",
        "--paper-only",
        "--rest",
        "0",
    ]);
    let mut seen = BTreeMap::<(String, String), Vec<f64>>::new();
    for row in rows(&out.join("readings.csv")) {
        let column = if row["axis"] == "ty" { "ty_m" } else { "roll_rad" };
        let error = 1e6 * (number(&row, column) - number(&row, "reference_si"));
        seen.entry((row["axis"].clone(), row["reference_si"].clone())).or_default().push(error);
        assert!(row["status"].contains("POSE_VALID") && !row["status"].contains("NOT_LOCKED"), "{row:?}");
    }
    let sorted = |axis: &str| {
        let mut all: Vec<f64> =
            seen.keys().filter(|(a, _)| a == axis).map(|(_, r)| r.parse::<f64>().unwrap() * 1e6).collect();
        all.sort_by(f64::total_cmp);
        all
    };
    for (axis, expected) in
        [("ty", [-2.84, -1.42, 0.0, 1.42, 2.84]), ("roll", [-200.0, -100.0, 0.0, 100.0, 200.0])]
    {
        for (found, expected) in sorted(axis).iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{axis}: {found} {expected}");
        }
    }
    for ((axis, at), errors) in seen {
        let n = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / n;
        // 4.5 standard uncertainties of the mean.
        assert!(mean.abs() < 4.5 * deviation(&errors) / n.sqrt(), "{axis} at {at}: {mean}");
    }
}

#[test]
fn the_same_seed_gives_the_same_files() {
    let arguments = |seed| ["--seed", seed, "--axes", "yaw", "--rest", "1"];
    let [(_a, a), (_b, b), (_c, c)] = ["7", "7", "8"].map(|seed| done(&arguments(seed)));
    for name in ["readings.csv", "table2.csv", "report.html"] {
        let read = |out: &std::path::Path| fs::read(out.join(name)).unwrap();
        assert!(read(&a) == read(&b), "{name}");
        assert!(read(&a) != read(&c), "{name}");
    }
}

#[test]
fn the_report_can_be_recreated_from_its_readings() {
    let (folder, out) = done(&["--seed", "3", "--axes", "tz", "--rest", "1"]);
    let again = folder.path().join("again");
    let file = out.join("readings.csv");
    let read = |out: &std::path::Path, name: &str| fs::read_to_string(out.join(name)).unwrap();
    let before = ["readings.csv", "table2.csv"].map(|name| read(&out, name));
    let output = run(&again, &["--from", file.to_str().unwrap()]);
    assert!(output.status.success(), "{}", super::said(&output));
    assert!(before == ["readings.csv", "table2.csv"].map(|name| read(&again, name)));
    assert!(read(&again, "report.html").contains("digital twin, seed 3"));
    assert!(read(&out, "report.html") == read(&again, "report.html"));
    // Also in place, after the report was deleted.
    fs::remove_file(out.join("report.html")).unwrap();
    let output = run(&out, &["--from", file.to_str().unwrap()]);
    assert!(output.status.success() && out.join("report.html").exists(), "{}", super::said(&output));
}

#[test]
fn the_twin_takes_the_positions_of_a_reference_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lab.csv");
    fs::write(
        &file,
        "axis,unit,point,reference\npitch,arcsec,1,-10\npitch,arcsec,2,0.5\npitch,mrad,3,0.05\n",
    )
    .unwrap();
    let (_folder, out) =
        done(&["--reference", file.to_str().unwrap(), "--readings", "200", "--paper-only", "--rest", "0"]);
    let points = points(&out, "table2", "pitch");
    for (point, truth) in points.iter().zip([-48.481, 2.424, 50.0]) {
        let mean = point.iter().sum::<f64>() / 200.0;
        assert!((mean - truth).abs() < 4.5 * 1.764 / 200.0_f64.sqrt(), "{mean} {truth}");
    }
    assert_eq!(points.len(), 3);
}

#[test]
fn a_gap_in_the_record_at_rest_omits_only_the_allan_deviation() {
    let (folder, out) =
        done(&["--axes", "tz", "--points", "3", "--readings", "3", "--paper-only", "--rest", "1"]);
    let text = fs::read_to_string(out.join("readings.csv")).unwrap();
    let holed =
        |line: &&str| !(line.starts_with("rest,") && line.split(',').nth(3).unwrap().starts_with("50"));
    let file = folder.path().join("holed.csv");
    fs::write(&file, text.lines().filter(holed).collect::<Vec<_>>().join("\n")).unwrap();
    let again = folder.path().join("again");
    let output = run(&again, &["--from", file.to_str().unwrap()]);
    let told = super::said(&output);
    let why = "0.0110 s from one reading to the next instead of 0.0010 s";
    assert!(output.status.success() && told.contains(why), "{told}");
    let html = fs::read_to_string(again.join("report.html")).unwrap();
    assert!(html.contains(&format!("No Allan deviation: {why}")));
    assert!(html.contains("drift per hour") && html.contains("data-kind=\"displacement\""));
    let columns: Vec<_> =
        text.lines().find(|line| line.starts_with("rest,,0,700,")).unwrap().split(',').collect();
    let mut other = columns.clone();
    other[19] = "12345";
    fs::write(&file, text.replace(&columns.join(","), &other.join(","))).unwrap();
    let output = run(&folder.path().join("tared"), &["--from", file.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(65), "{}", super::said(&output));
    assert!(super::said(&output).contains("the record at rest: geometry, calibration or frames"));
}
