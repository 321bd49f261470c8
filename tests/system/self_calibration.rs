//! A calibration without a reference: free motion and scans of the steering, measured on a twin with a head of its own.

use std::path::Path;
use std::sync::OnceLock;

use crate::testkit::{self, Done, Folder, run};

/// The rough head of the example, with a laser that does not drift.
fn head() -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/real-head.toml");
    let mut text = std::fs::read_to_string(file).unwrap();
    for (from, to) in [
        ("pointing_um = 0.1               # slow", "pointing_um = 0.0               # slow"),
        ("warm_up_k = 0.1", "warm_up_k = 0.0"),
        ("swing_k = 0.03", "swing_k = 0.0"),
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
