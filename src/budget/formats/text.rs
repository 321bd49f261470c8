//! The budget as a table of at most 100 columns.

use std::fmt::Write as _;

use trifacet_budget::Verdict;

use super::super::assessment::MEASURANDS;
use super::Report;
use super::numbers::{aligned, rounded_as, significant};
use super::rows::{Row, dof_text, negligible, rows};

const NAME: usize = 32;
const CELL: usize = 11;
/// Longest line of a paragraph.
const WIDTH: usize = 98;

pub fn text(report: &Report) -> String {
    let mut out = String::new();
    let rows = rows(&report.assessment);
    head(&mut out, report);
    quantities(&mut out, &rows);
    let header = MEASURANDS.map(|(name, unit)| format!("{name}/{}", unit.micro()));
    section(&mut out, "Sensitivities, in the unit of the measurand per unit of the quantity");
    line(&mut out, "quantity", &header);
    let budget = &report.assessment.budget;
    table(&mut out, &rows, |row, j| {
        let sensitivity = row.sensitivity[j].filter(|_| !negligible(budget, row, j));
        sensitivity.map_or("-".into(), |c| significant(c, 3))
    });
    section(&mut out, "Contributions, sensitivity times standard uncertainty");
    line(&mut out, "quantity", &header);
    table(&mut out, &rows, |row, j| {
        if negligible(budget, row, j) { "-".into() } else { significant(row.contribution[j] * 1e6, 2) }
    });
    shares(&mut out, report, &rows);
    paragraph(
        &mut out,
        "-: less than a millionth of u_c; of a sensitivity also: the uncertainties of the row differ. A row with several quantities (u and v of A, B, C; x, y, z) states the uncertainty of each. Its sensitivity and its \
         contribution are the root of the sum of their squares.",
    );
    combined(&mut out, report, &header);
    correlation(&mut out, report);
    monte_carlo(&mut out, report);
    range(&mut out, report);
    list(&mut out, "Not covered", report.assessment.not_covered.iter().map(ToString::to_string));
    list(&mut out, "Notes", report.assessment.notes.iter().cloned());
    section(&mut out, "Verdict");
    paragraph(&mut out, &report.assessment.verdict());
    out
}

// Writing into a String does not fail.
fn section(out: &mut String, title: &str) {
    let _ = writeln!(out, "\n{title}\n");
}

fn line(out: &mut String, name: &str, cells: &[String]) {
    let _ = write!(out, "{name:<NAME$}");
    for cell in cells {
        let _ = write!(out, "{cell:>CELL$}");
    }
    out.truncate(out.trim_end().len());
    out.push('\n');
}

/// Breaks a text into lines.
fn paragraph(out: &mut String, text: &str) {
    let mut length = 0;
    for word in text.split_whitespace() {
        if length + word.len() + 1 > WIDTH {
            out.push('\n');
            length = 0;
        } else if length > 0 {
            out.push(' ');
            length += 1;
        }
        out.push_str(word);
        length += word.len();
    }
    out.push('\n');
}

fn list(out: &mut String, title: &str, items: impl Iterator<Item = String>) {
    let items: Vec<_> = items.collect();
    if !items.is_empty() {
        section(out, title);
        for item in items {
            paragraph(out, &format!("- {item}"));
        }
    }
}

fn head(out: &mut String, report: &Report) {
    let version = env!("CARGO_PKG_VERSION");
    let _ = writeln!(out, "Uncertainty budget of a pose relative to the tare");
    let _ = writeln!(out, "trifacet {version}, configuration {}", report.configuration);
    let pose = report.assessment.pose.to_array().map(|value| significant(value * 1e6, 6));
    let [x, y, z, roll, pitch, yaw] = pose;
    let _ = writeln!(out, "pose: tx {x}, ty {y}, tz {z} um, roll {roll}, pitch {pitch}, yaw {yaw} urad");
    let _ = writeln!(out, "samples averaged: {}", report.average);
    if let Some(range) = &report.range {
        let (mm, mrad) = (range.metres * 1e3, range.radians * 1e3);
        let _ = writeln!(out, "This is the worst pose within +-{mm} mm and +-{mrad} mrad.");
    }
    if !report.tared {
        let _ = writeln!(out, "The configuration has no tare: the mirror is centred at the tare.");
    }
}

fn quantities(out: &mut String, rows: &[Row]) {
    section(out, "Input quantities");
    let column = |of: &dyn Fn(&Row) -> String| aligned(&rows.iter().map(of).collect::<Vec<_>>());
    let micro = |x: Option<f64>, digits| x.map_or("differs".into(), |x| significant(x * 1e6, digits));
    let (values, stds) = (column(&|row| micro(row.value, 4)), column(&|row| micro(row.std, 2)));
    let _ = writeln!(
        out,
        "{:<NAME$}{:>4}{:>10}{:>12} {:<5}{:<13}{:<5}{:>7}",
        "quantity", "n", "value", "u", "unit", "distribution", "type", "dof"
    );
    for ((row, value), std) in rows.iter().zip(values).zip(stds) {
        let _ = writeln!(
            out,
            "{:<NAME$}{:>4}{value:>10}{std:>12} {:<5}{:<13}{:<5}{:>7}",
            row.name,
            row.count,
            row.unit.micro(),
            row.distribution,
            row.evaluation,
            dof_text(Some(row.dof))
        );
    }
}

fn table(out: &mut String, rows: &[Row], cell: impl Fn(&Row, usize) -> String) {
    let columns: [Vec<String>; 6] =
        std::array::from_fn(|j| aligned(&rows.iter().map(|row| cell(row, j)).collect::<Vec<_>>()));
    for (i, row) in rows.iter().enumerate() {
        line(out, &row.name, &columns.each_ref().map(|column| column[i].clone()));
    }
}

fn shares(out: &mut String, report: &Report, rows: &[Row]) {
    section(out, "Shares of the variance, percent");
    line(out, "quantity", &MEASURANDS.map(|(name, _)| name.to_owned()));
    let percent = |share: f64| format!("{:.1}", (share * 1000.0).round() / 10.0 + 0.0);
    for row in rows {
        line(out, &row.name, &row.share.map(percent));
    }
    let budget = &report.assessment.budget;
    let correlations: [f64; 6] = std::array::from_fn(|j| budget.correlation_share(j));
    line(out, "correlations", &correlations.map(percent));
    let sum = |j: usize| correlations[j] + rows.iter().map(|row| row.share[j]).sum::<f64>();
    line(out, "sum", &std::array::from_fn::<_, 6, _>(|j| percent(sum(j))));
    out.push('\n');
}

fn combined(out: &mut String, report: &Report, header: &[String]) {
    let (budget, p) = (&report.assessment.budget, report.probability);
    section(out, &format!("Combined, coverage probability {} %", significant(p * 100.0, 4)));
    line(out, "", header);
    let row = |of: &dyn Fn(usize) -> String| -> [String; 6] { std::array::from_fn(of) };
    let u = |j: usize| budget.standard_uncertainty(j) * 1e6;
    let pose = report.assessment.pose.to_array();
    line(out, "value", &row(&|j| rounded_as(pose[j] * 1e6, u(j))));
    line(out, "u_c, standard uncertainty", &row(&|j| significant(u(j), 2)));
    line(out, "nu_eff, degrees of freedom", &row(&|j| dof_text(budget.effective_dof(j))));
    line(out, "k, coverage factor", &row(&|j| format!("{:.2}", budget.coverage_factor(j, p))));
    line(out, "U, expanded uncertainty", &row(&|j| significant(budget.expanded(j, p) * 1e6, 2)));
    if (0..6).any(|j| budget.effective_dof(j).is_none()) {
        paragraph(
            out,
            "nu_eff is not defined where a quantity with a finite number of degrees of freedom is correlated with another \
             one; k is then that of the normal distribution.",
        );
    }
}

fn correlation(out: &mut String, report: &Report) {
    section(out, "Correlation of the measurands");
    let names = MEASURANDS.map(|(name, _)| name.to_owned());
    line(out, "", &names);
    for (i, name) in names.iter().enumerate() {
        line(
            out,
            name,
            &std::array::from_fn::<_, 6, _>(|j| {
                let r = report.assessment.budget.correlation(i, j);
                format!("{:.2}", if r.abs() < 0.005 { 0.0 } else { r })
            }),
        );
    }
}

fn monte_carlo(out: &mut String, report: &Report) {
    let Some(trials) = &report.trials else { return };
    let title = format!("Monte Carlo method (JCGM 101), {} trials through the full model", trials.trials());
    section(out, &title);
    let micro = |name: &str| format!("{name}, um or urad");
    line(out, "", &MEASURANDS.map(|(name, _)| name.to_owned()));
    let budget = &report.assessment.budget;
    let u = |j: usize| budget.standard_uncertainty(j) * 1e6;
    let row = |of: &dyn Fn(usize) -> String| -> [String; 6] { std::array::from_fn(of) };
    line(out, &micro("mean"), &row(&|j| rounded_as(trials.estimate(j) * 1e6, u(j))));
    line(out, &micro("u"), &row(&|j| significant(trials.standard_uncertainty(j) * 1e6, 2)));
    let ends: [_; 6] = std::array::from_fn(|j| trials.symmetric(j));
    let checks: [_; 6] = std::array::from_fn(|j| report.assessment.validation(j, trials));
    line(out, &micro("interval, low"), &row(&|j| rounded_as(ends[j].low * 1e6, u(j))));
    line(out, &micro("interval, high"), &row(&|j| rounded_as(ends[j].high * 1e6, u(j))));
    line(out, "difference at the low end", &row(&|j| significant(checks[j].low * 1e6, 2)));
    line(out, "difference at the high end", &row(&|j| significant(checks[j].high * 1e6, 2)));
    line(out, "limit of validation", &row(&|j| significant(checks[j].tolerance * 1e6, 2)));
    line(out, "scatter of an end", &row(&|j| significant(checks[j].scatter * 1e6, 2)));
    line(out, "linear budget validated", &row(&|j| verdict(checks[j].verdict).to_owned()));
    if checks.iter().any(|check| check.verdict == Verdict::Undecided) {
        paragraph(
            out,
            "undecided: the scatter of the trials reaches across the limit; --trials with a larger number decides.",
        );
    }
    if trials.failed() > 0 {
        paragraph(out, &format!("{} trials gave no pose and are left out.", trials.failed()));
    }
}

pub fn verdict(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Validated => "yes",
        Verdict::NotValidated => "no",
        Verdict::Undecided => "undecided",
    }
}

fn range(out: &mut String, report: &Report) {
    let Some(range) = &report.range else { return };
    section(out, "Largest standard uncertainty within the range, and the pose where it occurs (um, urad)");
    let columns = MEASURANDS.map(|(name, _)| name.to_owned());
    let _ = writeln!(
        out,
        "{:<12}{:>10}   at{}",
        "measurand",
        "u_c",
        columns.map(|c| format!("{c:>10}")).concat()
    );
    for ((name, unit), (u, pose)) in MEASURANDS.iter().zip(&range.largest) {
        let pose = pose.to_array().map(|value| format!("{:>10.1}", value * 1e6 + 0.0)).concat();
        let _ = writeln!(
            out,
            "{:<12}{:>10}     {pose}",
            format!("{name}/{}", unit.micro()),
            significant(u * 1e6, 2)
        );
    }
    paragraph(
        out,
        "Searched: the 64 corners, the middle, the 12 ends of the axes, and 200 poses at random with a fixed seed. The worst pose \
         has the largest sum of the six variances, each relative to that at the tare.",
    );
}
