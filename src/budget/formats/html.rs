//! The budget as a page that prints on A4. No script, no external resource.

use std::fmt::Write as _;

use super::super::assessment::MEASURANDS;
use super::Report;
use super::numbers::{rounded_as, significant};
use super::rows::{Row, dof_text, negligible, rows};
use super::text::verdict;

const STYLE: &str = "\
@page { size: A4; margin: 15mm }\n\
body { font: 10pt/1.35 sans-serif; color: #000; background: #fff; max-width: 180mm; margin: 1em auto }\n\
h1 { font-size: 15pt } h2 { font-size: 11pt; margin: 1.2em 0 .3em; break-after: avoid }\n\
table { border-collapse: collapse; width: 100%; font-size: 8.5pt; break-inside: avoid }\n\
th, td { border-bottom: .3pt solid #999; padding: 1pt 4pt; text-align: right; font-variant-numeric: tabular-nums }\n\
th:first-child, td:first-child, .t { text-align: left }\n\
thead th, tr.sum td { border-bottom: .8pt solid #000; font-weight: bold }\n\
.verdict { border: .8pt solid #000; padding: .5em .8em }\n";

pub fn html(report: &Report) -> String {
    let rows = rows(&report.assessment);
    let mut page = Page(String::new());
    let title = "Uncertainty budget of a pose relative to the tare";
    page.raw(&format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n"
    ));
    head(&mut page, report);
    quantities(&mut page, &rows);
    let header = MEASURANDS.map(|(name, unit)| format!("{name} / {}", unit.micro()));
    let budget = &report.assessment.budget;
    let all = |of: &dyn Fn(usize) -> String| -> [String; 6] { std::array::from_fn(of) };
    page.section("Sensitivities, in the unit of the measurand per unit of the quantity");
    page.table(
        &header,
        rows.iter().map(|row| {
            let cell = |j: usize| {
                row.sensitivity[j]
                    .filter(|_| !negligible(budget, row, j))
                    .map_or("–".into(), |c| significant(c, 3))
            };
            (row.name.clone(), all(&cell))
        }),
    );
    page.section("Contributions, sensitivity times standard uncertainty");
    page.table(
        &header,
        rows.iter().map(|row| {
            let cell = |j: usize| {
                if negligible(budget, row, j) {
                    "–".into()
                } else {
                    significant(row.contribution[j] * 1e6, 2)
                }
            };
            (row.name.clone(), all(&cell))
        }),
    );
    page.section("Shares of the variance, percent");
    let percent = |share: f64| format!("{:.1}", (share * 1000.0).round() / 10.0 + 0.0);
    let shares = rows.iter().map(|row| (row.name.clone(), row.share.map(percent)));
    let rest = ("correlations".to_owned(), all(&|j| percent(budget.correlation_share(j))));
    page.table(&MEASURANDS.map(|(name, _)| name.to_owned()), shares.chain([rest]));
    combined(&mut page, report, &header);
    monte_carlo(&mut page, report);
    range(&mut page, report);
    page.list("Not covered", report.assessment.not_covered.iter().map(ToString::to_string));
    page.list("Notes", report.assessment.notes.iter().cloned());
    page.section("Verdict");
    page.raw(&format!("<p class=\"verdict\">{}</p>\n", escaped(&report.assessment.verdict())));
    page.raw("<h2>Signed</h2>\n<p>Date: ____________________ &nbsp; Name: ______________________________</p>\n</body>\n</html>\n");
    page.0
}

struct Page(String);

impl Page {
    fn raw(&mut self, html: &str) {
        self.0.push_str(html);
    }

    fn section(&mut self, title: &str) {
        self.raw(&format!("<h2>{}</h2>\n", escaped(title)));
    }

    fn paragraph(&mut self, text: &str) {
        self.raw(&format!("<p>{}</p>\n", escaped(text)));
    }

    fn list(&mut self, title: &str, items: impl Iterator<Item = String>) {
        let items: Vec<_> = items.map(|item| format!("<li>{}</li>\n", escaped(&item))).collect();
        if !items.is_empty() {
            self.section(title);
            self.raw(&format!("<ul>\n{}</ul>\n", items.concat()));
        }
    }

    /// A table with a name and six numbers in each row.
    fn table(&mut self, header: &[String; 6], rows: impl Iterator<Item = (String, [String; 6])>) {
        let cells = |tag: &str, cells: &[String]| -> String {
            cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell))).collect::<Vec<_>>().concat()
        };
        self.raw(&format!("<table>\n<thead><tr><th></th>{}</tr></thead>\n", cells("th", header)));
        for (name, row) in rows {
            self.raw(&format!("<tr><td>{}</td>{}</tr>\n", escaped(&name), cells("td", &row)));
        }
        self.raw("</table>\n");
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn head(page: &mut Page, report: &Report) {
    let version = env!("CARGO_PKG_VERSION");
    page.paragraph(&format!("trifacet {version}, configuration {}", report.configuration));
    let [x, y, z, roll, pitch, yaw] = report.assessment.pose.to_array().map(|v| significant(v * 1e6, 6));
    page.paragraph(&format!(
        "Pose: tx {x}, ty {y}, tz {z} um, roll {roll}, pitch {pitch}, yaw {yaw} urad. Samples averaged: {}.",
        report.average
    ));
    if let Some(range) = &report.range {
        let (mm, mrad) = (range.metres * 1e3, range.radians * 1e3);
        page.paragraph(&format!("This is the worst pose within +-{mm} mm and +-{mrad} mrad."));
    }
    if !report.tared {
        page.paragraph("The configuration has no tare: the mirror is centred at the tare.");
    }
}

fn quantities(page: &mut Page, rows: &[Row]) {
    page.section("Input quantities");
    page.raw(
        "<table>\n<thead><tr><th>quantity</th><th>n</th><th>value</th><th>u</th><th class=\"t\">unit</th>\
         <th class=\"t\">distribution</th><th class=\"t\">type</th><th>dof</th><th class=\"t\">source</th></tr></thead>\n",
    );
    let micro = |x: Option<f64>, digits| x.map_or("differs".into(), |x| significant(x * 1e6, digits));
    for row in rows {
        // Writing into a String does not fail.
        let _ = writeln!(
            page.0,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td class=\"t\">{}</td><td class=\"t\">{}</td>\
             <td class=\"t\">{}</td><td>{}</td><td class=\"t\">{}</td></tr>",
            escaped(&row.name),
            row.count,
            micro(row.value, 4),
            micro(row.std, 2),
            row.unit.micro(),
            row.distribution,
            row.evaluation,
            dof_text(Some(row.dof)),
            escaped(&row.source)
        );
    }
    page.raw("</table>\n");
    page.paragraph(
        "–: less than a millionth of u_c; of a sensitivity also: the uncertainties of the row differ. A row with several quantities (u and v of A, B, C; x, y, z) states the uncertainty of each. Its sensitivity and its \
         contribution are the root of the sum of their squares.",
    );
}

fn combined(page: &mut Page, report: &Report, header: &[String; 6]) {
    let (budget, p) = (&report.assessment.budget, report.probability);
    let all = |of: &dyn Fn(usize) -> String| -> [String; 6] { std::array::from_fn(of) };
    let u = |j: usize| budget.standard_uncertainty(j) * 1e6;
    let pose = report.assessment.pose.to_array();
    page.section(&format!("Combined, coverage probability {} %", significant(p * 100.0, 4)));
    page.table(
        header,
        [
            ("value".to_owned(), all(&|j| rounded_as(pose[j] * 1e6, u(j)))),
            ("u_c, standard uncertainty".to_owned(), all(&|j| significant(u(j), 2))),
            ("nu_eff, degrees of freedom".to_owned(), all(&|j| dof_text(budget.effective_dof(j)))),
            ("k, coverage factor".to_owned(), all(&|j| format!("{:.2}", budget.coverage_factor(j, p)))),
            ("U, expanded uncertainty".to_owned(), all(&|j| significant(budget.expanded(j, p) * 1e6, 2))),
        ]
        .into_iter(),
    );
    page.section("Correlation of the measurands");
    let names = MEASURANDS.map(|(name, _)| name.to_owned());
    let round = |r: f64| format!("{:.2}", (r * 100.0).round() / 100.0 + 0.0);
    let rows = (0..6).map(|i| (names[i].clone(), all(&|j| round(budget.correlation(i, j)))));
    page.table(&names, rows);
}

fn monte_carlo(page: &mut Page, report: &Report) {
    let Some(trials) = &report.trials else { return };
    page.section(&format!(
        "Monte Carlo method (JCGM 101), {} trials through the full model; um, urad",
        trials.trials()
    ));
    let u = |j: usize| report.assessment.budget.standard_uncertainty(j) * 1e6;
    let all = |of: &dyn Fn(usize) -> String| -> [String; 6] { std::array::from_fn(of) };
    let ends: [_; 6] = std::array::from_fn(|j| trials.symmetric(j));
    let checks: [_; 6] = std::array::from_fn(|j| report.assessment.validation(j, trials));
    page.table(
        &MEASURANDS.map(|(name, _)| name.to_owned()),
        [
            ("mean".to_owned(), all(&|j| rounded_as(trials.estimate(j) * 1e6, u(j)))),
            ("u".to_owned(), all(&|j| significant(trials.standard_uncertainty(j) * 1e6, 2))),
            ("interval, low".to_owned(), all(&|j| rounded_as(ends[j].low * 1e6, u(j)))),
            ("interval, high".to_owned(), all(&|j| rounded_as(ends[j].high * 1e6, u(j)))),
            ("difference at the low end".to_owned(), all(&|j| significant(checks[j].low * 1e6, 2))),
            ("difference at the high end".to_owned(), all(&|j| significant(checks[j].high * 1e6, 2))),
            ("limit of validation".to_owned(), all(&|j| significant(checks[j].tolerance * 1e6, 2))),
            ("scatter of an end".to_owned(), all(&|j| significant(checks[j].scatter * 1e6, 2))),
            ("linear budget validated".to_owned(), all(&|j| verdict(checks[j].verdict).to_owned())),
        ]
        .into_iter(),
    );
}

fn range(page: &mut Page, report: &Report) {
    let Some(range) = &report.range else { return };
    page.section("Largest standard uncertainty within the range, and the pose where it occurs; um, urad");
    let names = MEASURANDS.map(|(name, _)| name.to_owned());
    let rows = MEASURANDS.iter().zip(&range.largest).map(|((name, _), (u, pose))| {
        let pose = pose.to_array().map(|value| format!("{:.1}", value * 1e6 + 0.0));
        (format!("{name}: u_c {} at", significant(u * 1e6, 2)), pose)
    });
    page.table(&names, rows);
}
