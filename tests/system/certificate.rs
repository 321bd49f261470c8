//! The certificate of a calibration: what it contains, what it refuses, and what foreign programs say about it.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use serde_json::{Value, json};

use crate::testkit::{self, Browser, Done, Folder, run, venv};

/// A calibration of the reference points, as of a head with a board; made once for all tests.
fn calibration() -> PathBuf {
    static FOLDER: OnceLock<Folder> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let folder = Folder::new();
        let config = folder.write("head.toml", "acquisition.source = \"serial\"\n");
        fitted(&config, &folder.path("calibrated"));
        folder
    });
    folder.path("calibrated")
}

fn fitted(config: &Path, out: &Path) {
    let points = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference/calibration");
    let mut fit = testkit::trifacet(&["calibrate", "fit"]);
    fit.arg("--config").arg(config).arg("--points").arg(points.join("mild.points.csv"));
    fit.arg("--scan").arg(points.join("mild.scan.csv")).arg("--out").arg(out);
    let done = run(&mut fit);
    assert_eq!(done.code, 0, "{}", done.err);
}

/// The template with every key, and these replacements of text.
fn laboratory(folder: &Folder, replaced: &[(&str, &str)]) -> PathBuf {
    let template = run(&mut testkit::trifacet(&["calibrate", "report", "--laboratory-template"]));
    assert_eq!(template.code, 0, "{}", template.err);
    let lines = template.out.lines().map(|line| line.strip_prefix("#: ").unwrap_or(line));
    let mut text = lines.collect::<Vec<_>>().join("\n");
    for (from, to) in replaced {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    folder.write("laboratory.toml", text)
}

fn report(calibration: &Path, laboratory: Option<&Path>, out: &Path, more: &[&str]) -> Done {
    let mut command = testkit::trifacet(&["calibrate", "report"]);
    command.arg(calibration).arg("--certificate").arg("--out").arg(out).args(more);
    if let Some(file) = laboratory {
        command.arg("--laboratory").arg(file);
    }
    run(&mut command)
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir(to).unwrap();
    for file in std::fs::read_dir(from).unwrap() {
        let file = file.unwrap();
        std::fs::copy(file.path(), to.join(file.file_name())).unwrap();
    }
}

#[test]
fn a_certificate_states_results_and_what_the_laboratory_stated() {
    let folder = Folder::new();
    let laboratory = laboratory(&folder, &[("Example Customer", "Smith & Sons <gauges>")]);
    let out = folder.path("certificate.html");
    let done = report(&calibration(), Some(&laboratory), &out, &[]);
    assert_eq!(done.code, 0, "{}", done.err);
    let page = std::fs::read_to_string(&out).unwrap();
    for part in [
        "Calibration certificate 2026-0147",
        "Smith &amp; Sons &lt;gauges&gt;",
        "calibrated by an institute whose calibrations are covered by the CIPM MRA",
        "19.9 °C to 20.1 °C",
        "k = 2",
        "relate only to the item",
        "A. Example",
        "End of the certificate",
        "psd-c.csv",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("not stated") && !page.contains("DRAFT") && !page.contains("<script"));
    let again = report(&calibration(), Some(&laboratory), &out, &[]);
    assert!(again.code != 0 && again.err.contains("exists"), "{}", again.err);

    // U is never below twice the uncertainty that the record states as rms over the range.
    let record = std::fs::read_to_string(calibration().join("report.json")).unwrap();
    let record: Value = serde_json::from_str(&record).unwrap();
    let stated = |group: &str, i: usize| record["std"][group][i].as_f64().unwrap();
    let row = page.lines().find(|line| line.contains("Expanded uncertainty U")).unwrap();
    let cells: Vec<f64> =
        row.split("<td>").skip(1).map(|cell| cell.split('<').next().unwrap().parse().unwrap()).collect();
    assert_eq!(cells.len(), 6);
    for (i, cell) in cells.iter().enumerate() {
        let (own, common) = if i < 3 { (stated("um", i), 0.05) } else { (stated("urad", i - 3), 0.2) };
        let least = 2.0 * own.hypot(common);
        assert!(*cell >= least && *cell < 3.0 * least, "axis {i}: {cell}, {least}");
    }
}

#[test]
fn what_is_not_stated_is_refused_by_name_and_marked_in_a_draft() {
    let folder = Folder::new();
    let out = folder.path("certificate.html");
    let laboratory = laboratory(&folder, &[("serial_number = \"0001\"", ""), ("common_um = 0.05", "")]);
    let refused = report(&calibration(), Some(&laboratory), &out, &[]);
    assert_eq!(refused.code, 65);
    assert!(refused.err.contains("not stated: item.serial_number, reference.common_um."), "{}", refused.err);
    assert!(!out.exists());
    let draft = report(&calibration(), Some(&laboratory), &out, &["--draft"]);
    assert_eq!(draft.code, 0, "{}", draft.err);
    let page = std::fs::read_to_string(&out).unwrap();
    assert!(page.contains("<span>DRAFT</span>") && page.contains("draft, not valid"));
    // The serial number, the uncertainty of the reference and U on three axes each.
    assert_eq!(page.matches("<span class=\"gap\">not stated</span>").count(), 1 + 3 + 3);
    let xml =
        report(&calibration(), Some(&laboratory), &folder.path("c.xml"), &["--draft", "--format", "dcc"]);
    assert!(xml.code == 64 && xml.err.contains("has no drafts"), "{}", xml.err);
}

#[test]
fn statements_that_cannot_be_are_refused() {
    let folder = Folder::new();
    for (from, to, code, expected) in [
        (
            "issued = \"2026-05-06\"",
            "issued = \"2026-05-03\"",
            78,
            "certificate.issued = \"2026-05-03\" is before",
        ),
        (
            "country = \"DE\"",
            "country = \"Germany\"",
            78,
            "laboratory.country = \"Germany\": allowed are two capital",
        ),
        ("number =", "nummer =", 78, "unknown field `nummer`"),
        (
            "ended = \"2026-05-04\"\n",
            "ended = \"2099-05-04\"\n",
            78,
            "certificate.issued = \"2026-05-06\" is before calibration.ended = \"2099-05-04\"",
        ),
        (
            "2026-05-0",
            "2099-05-0",
            65,
            "calibration.ended = \"2099-05-04\" is after the date of the calibration",
        ),
    ] {
        let laboratory = laboratory(&folder, &[(from, to)]);
        let out = folder.path("certificate.html");
        let done = report(&calibration(), Some(&laboratory), &out, &[]);
        assert!(done.code == code && done.err.contains(expected), "{to}: {} {}", done.code, done.err);
        assert!(!out.exists());
    }
}

#[test]
fn neither_a_simulated_head_nor_a_changed_configuration_gets_a_certificate() {
    let folder = Folder::new();
    let laboratory = laboratory(&folder, &[]);
    let out = folder.path("certificate.html");

    let changed = folder.path("changed");
    copy(&calibration(), &changed);
    let config = std::fs::read_to_string(changed.join("trifacet.toml")).unwrap();
    let twin = config.replace("source = \"serial\"", "source = \"twin\"");
    assert_ne!(config, twin);
    std::fs::write(changed.join("trifacet.toml"), twin).unwrap();
    let simulated = report(&changed, Some(&laboratory), &out, &[]);
    assert!(
        simulated.code == 65 && simulated.err.contains("a simulated head has no certificate"),
        "{}",
        simulated.err
    );

    let table = std::fs::read_to_string(changed.join("psd-b.csv")).unwrap();
    let mut lines: Vec<&str> = table.lines().collect();
    let mut fields: Vec<&str> = lines.pop().unwrap().split(',').collect();
    fields[2] = "1.234e-6";
    let last = fields.join(",");
    lines.push(&last);
    std::fs::write(changed.join("psd-b.csv"), lines.join("\n") + "\n").unwrap();
    std::fs::write(changed.join("trifacet.toml"), config).unwrap();
    let other = report(&changed, Some(&laboratory), &out, &["--draft"]);
    assert!(other.code == 65 && other.err.contains("were changed since the calibration"), "{}", other.err);
    assert!(!out.exists());
}

#[test]
fn the_schematron_of_the_ptb_accepts_the_digital_certificate() {
    let folder = Folder::new();
    let laboratory = laboratory(&folder, &[("Example Customer", "Smith & Sons <gauges>")]);
    let out = folder.path("certificate.xml");
    let done = report(&calibration(), Some(&laboratory), &out, &["--format", "dcc"]);
    assert_eq!(done.code, 0, "{}", done.err);
    let python = venv::python("dcc-venv", "dcclib, lxml", &["dcclib==0.4.0"]);
    let judged =
        venv::succeeded(Command::new(python).arg("tests/system/certificate.py").arg(&out), "certificate.py");
    let judged: Value = serde_json::from_slice(&judged.stdout).unwrap();
    assert_eq!(judged["findings"], json!([]), "{judged}");
    assert!(judged["rules_applied"].as_u64().unwrap() > 0, "{judged}");
    assert_eq!(judged["customer"], "Smith & Sons <gauges>");
    assert_eq!(judged["missing"], json!([]));
    assert_eq!(judged["expanded"].as_array().unwrap().len(), 6);
    // The rules find a mistake.
    let broken = std::fs::read_to_string(&out).unwrap().replace("<dcc:release>v", "<dcc:release>version ");
    let broken = folder.write("broken.xml", broken);
    let python = venv::python("dcc-venv", "dcclib, lxml", &["dcclib==0.4.0"]);
    let judged = venv::succeeded(
        Command::new(python).arg("tests/system/certificate.py").arg(broken),
        "certificate.py",
    );
    let judged: Value = serde_json::from_slice(&judged.stdout).unwrap();
    assert!(!judged["findings"].as_array().unwrap().is_empty(), "{judged}");
}

#[test]
fn each_printed_page_has_the_number_of_the_certificate() {
    let folder = Folder::new();
    let laboratory = laboratory(&folder, &[]);
    let out = folder.path("certificate.html");
    assert_eq!(report(&calibration(), Some(&laboratory), &out, &[]).code, 0);
    let mut browser = Browser::open(&format!("file://{}", out.display()), [1000, 1400]);
    browser.until("document.readyState === 'complete' && document.querySelector('.end') !== null");
    // Nothing is wider than the page.
    assert_eq!(browser.eval("document.documentElement.scrollWidth <= innerWidth"), true);
    assert_eq!(
        browser.eval("getComputedStyle(document.querySelector('.sheet > thead')).display"),
        "table-header-group"
    );
    let number = "document.querySelector('.sheet > thead').innerText.includes('2026-0147')";
    assert_eq!(browser.eval(number), true);
    let printed = browser.call("Page.printToPDF", &json!({ "preferCSSPageSize": true }));
    assert!(printed["data"].as_str().unwrap().len() > 10_000);
}
