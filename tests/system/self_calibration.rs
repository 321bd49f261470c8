//! A calibration without a reference: free motion and scans of the steering, measured on a twin with a head of its own.

use std::path::Path;
use std::sync::OnceLock;

use crate::testkit::{self, Done, Folder, run};

/// The rough head of the example, with a laser that does not drift, with the axes of the stage along those of the head,
/// which free motion does not tell, and with a steering whose matrix was measured before.
fn head() -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/real-head.toml");
    let mut text = std::fs::read_to_string(file).unwrap();
    for (from, to) in [
        ("pointing_um = 0.1               # slow", "pointing_um = 0.0               # slow"),
        ("warm_up_k = 0.1", "warm_up_k = 0.0"),
        ("swing_k = 0.03", "swing_k = 0.0"),
        ("stage_turn_mrad = 10.0", "stage_turn_mrad = 0.0"),
        ("stage_lever_mm = 2.0 ", "stage_lever_mm = 0.0 "),
        ("[steering]  ", "[steering]\nmatrix = [[0.985, 0.02], [-0.015, 1.01]]\n#"),
    ] {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    text
}

/// The folder with `head.toml`, `free.csv` (points without a reference) and `run/scan.csv`; measured once.
fn measured() -> &'static Folder {
    static FOLDER: OnceLock<Folder> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = Folder::new();
        let config = folder.write("head.toml", head());
        let step = |arguments: &[&str]| {
            let done = run(testkit::trifacet(arguments)
                .arg("--config")
                .arg(&config)
                .current_dir(config.parent().unwrap()));
            assert_eq!(done.code, 0, "{}", done.err);
        };
        step(&["calibrate", "plan", "--points", "400", "--out", "plan.csv"]);
        step(&["calibrate", "run", "--plan", "plan.csv", "--out", "run"]);
        let points = std::fs::read_to_string(folder.path("run/points.csv")).unwrap();
        folder.write("free.csv", without_reference(&points));
        folder
    })
}

fn without_reference(points: &str) -> String {
    let mut table = csv::Reader::from_reader(points.as_bytes());
    let header = table.headers().unwrap().clone();
    let kept: Vec<usize> = (0..header.len()).filter(|i| !header[*i].starts_with("ref_")).collect();
    assert!(kept.len() < header.len());
    let line = |row: &csv::StringRecord| kept.iter().map(|i| &row[*i]).collect::<Vec<_>>().join(",") + "\n";
    let mut text = line(&header);
    for row in table.records() {
        text += &line(&row.unwrap());
    }
    text
}

/// Fits a file of points; the scans are added where `scans`.
fn fit(points: &str, scans: bool, out: &Path, more: &[&str]) -> Done {
    let folder = measured();
    let mut command = testkit::trifacet(&["calibrate", "fit"]);
    command.arg("--config").arg(folder.path("head.toml")).arg("--points").arg(folder.path(points));
    if scans {
        for scan in ["run/scan.csv", "run/scan-end.csv"] {
            command.arg("--scan").arg(folder.path(scan));
        }
    }
    run(command.arg("--out").arg(out).args(more))
}

#[test]
fn what_free_motion_and_scans_cannot_tell_is_refused_with_advice() {
    let folder = Folder::new();
    let out = folder.path("calibrated");
    for (points, more, expected) in [
        (
            "free.csv",
            &[][..],
            &[
                "the scale of all poses is that of the steering's readback, which is not known",
                "--steering-scale-percent",
            ][..],
        ),
        ("run/scan.csv", &[], &["free motion only", "Measure points with a reference"]),
        (
            "free.csv",
            &["--steering-scale-percent", "5"],
            &["known to 5 %", "no better than those of the nominal head", "1 % is allowed"],
        ),
        (
            "run/scan.csv",
            &["--steering-scale-percent", "0.1"],
            &["a scan of the steering with the mirror at rest does not calibrate poses", "Add free motion"],
        ),
        (
            "free.csv",
            &["--steering-scale-percent", "0.1", "--want-um", "0.2", "--want-urad", "0.5"],
            &[
                "the standard uncertainty over the range",
                "wanted is 0.2 um",
                "wanted is 0.5 urad",
                "with a reference",
            ],
        ),
    ] {
        let done = fit(points, points == "free.csv", &out, more);
        assert_eq!(done.code, 65, "{points} {more:?}: {}", done.err);
        for part in expected {
            assert!(done.err.contains(part), "{points} {more:?}: {part}: {}", done.err);
        }
        assert!(!out.exists(), "nothing is written");
    }
}

const POSE: [&str; 6] = ["tx_m", "ty_m", "tz_m", "roll_rad", "pitch_rad", "yaw_rad"];

/// Columns of a table, by row.
fn columns(table: &str, names: &[String]) -> Vec<Vec<f64>> {
    let mut table = csv::Reader::from_reader(table.as_bytes());
    let header = table.headers().unwrap().clone();
    let places: Vec<usize> = names.iter().map(|n| header.iter().position(|h| h == n).unwrap()).collect();
    let row = |row: csv::StringRecord| places.iter().map(|i| row[*i].parse().unwrap()).collect();
    table.records().map(|record| row(record.unwrap())).collect()
}

fn named(prefix: &str) -> Vec<String> {
    POSE.map(|name| format!("{prefix}{name}")).to_vec()
}

/// Errors of the poses of the free motion relative to the first one, against the truth of the twin, and their stated
/// standard uncertainties by the calibration, if there is one.
fn errors(config: &Path) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
    let mut solve = testkit::trifacet(&["solve", "--readings", "--frames", "--tare-row", "1", "--sigma"]);
    let solved = run(solve.arg("--config").arg(config).arg(measured().path("free.csv")));
    assert_eq!(solved.code, 0, "{}", solved.err);
    let found = columns(&solved.out, &named(""));
    let calibrated = solved.out.contains("cal_std_");
    let stated = if calibrated { columns(&solved.out, &named("cal_std_")) } else { vec![Vec::new()] };
    let truth = columns(&std::fs::read_to_string(measured().path("run/points.csv")).unwrap(), &named("ref_"));
    assert_eq!(found.len(), truth.len());
    // The truth is relative to a pose at which all angles are zero within the noise of the reference.
    let error = |k: usize| (0..6).map(|i| found[k][i] - (truth[k][i] - truth[0][i])).collect();
    ((1..found.len()).map(error).collect(), stated[1..].to_vec())
}

fn rms<'a>(rows: impl IntoIterator<Item = &'a Vec<f64>>, axes: std::ops::Range<usize>) -> f64 {
    let squares: Vec<f64> =
        rows.into_iter().flat_map(|row| row[axes.clone()].to_vec()).map(|x| x * x).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn free_motion_and_scans_with_a_known_scale_give_poses_within_their_stated_uncertainty() {
    let folder = Folder::new();
    let out = folder.path("calibrated");
    let done = fit("free.csv", true, &out, &["--steering-scale-percent", "0.1"]);
    assert_eq!(done.code, 0, "{}", done.err);
    let (errors, stated) = self::errors(&out.join("trifacet.toml"));
    let (before, _) = self::errors(&measured().path("head.toml"));
    for (axes, unit) in [(0..3, "um"), (3..6, "urad")] {
        let [error, known, nominal] =
            [(&errors), (&stated), (&before)].map(|rows| rms(rows, axes.clone()) * 1e6);
        println!("{unit}: error {error:.2}, stated {known:.2}, nominal head {nominal:.2}");
        assert!(error < nominal / 2.0, "{unit}: {error} {nominal}");
        assert!((0.2..1.6).contains(&(error / known)), "{unit}: {error} {known}");
    }
    // Errors are common to all poses, and so differ from head to head: no 95 % of them must be within 1.96 deviations.
    let all = errors.iter().zip(&stated).flat_map(|(e, s)| e.iter().zip(s));
    let within = all.clone().filter(|(e, s)| e.abs() < 3.0 * **s + 1e-7).count() as f64 / all.count() as f64;
    assert!(within > 0.95, "{within}");
}
