//! The certificate as a page for A4 paper.

use std::fmt::Write as _;

use super::laboratory::Party;
use super::{AXES, COVERAGE_FACTOR, Certificate, rounded_up, six};
use crate::calibration::report::escaped;

const STYLE: &str = include_str!("certificate.css");
const GAP: &str = "<span class=\"gap\">not stated</span>";

pub(super) const ONLY_THE_ITEM: &str = "The results relate only to the item that was calibrated, in the condition in \
                                        which it was received, and to the calibrated configuration and correction \
                                        tables with the stated hashes.";
pub(super) const WHY_NO_PARAMETERS: &str = "Poses are certified, not the parameters of the head: many combinations of parameters have the same effect on all \
     poses, so that no measurement tells them apart.";
const IN_FULL: &str =
    "This certificate shall not be reproduced except in full without the approval of the laboratory.";

impl Certificate {
    /// The certificate as HTML: no script, no other file.
    pub fn html(&self) -> String {
        let laboratory = &self.laboratory;
        let number = stated(laboratory.certificate.number.as_ref());
        let title = laboratory.certificate.number.as_deref().unwrap_or("not stated");
        let draft = if self.draft {
            "<div class=\"draft\" aria-hidden=\"true\"><span>DRAFT</span></div>\n"
        } else {
            ""
        };
        // The head of a table is repeated on each printed page.
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Calibration certificate {}{}\
             </title>\n<style>\n{STYLE}</style></head><body>\n{draft}<table class=\"sheet\"><thead><tr><td>{}</td>\
             <td>Calibration certificate {number}{}</td></tr><tr class=\"space\"></tr></thead><tbody><tr><td colspan=\"2\">\n<h1>Calibration \
             certificate</h1>\n{}</td></tr></tbody></table>\n</body></html>\n",
            escaped(title),
            if self.draft { " (draft)" } else { "" },
            stated(laboratory.laboratory.name.as_ref()),
            if self.draft { ", draft, not valid" } else { "" },
            self.body(),
        )
    }

    fn body(&self) -> String {
        let mut page = self.identity();
        page += &self.measurement();
        page += &self.results();
        page +=
            &section("Measurement uncertainty", &paragraph(&format!("{}.", self.uncertainty_statement())));
        let mut remarks = String::new();
        for warning in &self.findings.warnings {
            remarks += &paragraph(&format!("Found by the evaluation: {warning}."));
        }
        if let Some(text) = &self.laboratory.certificate.remarks {
            remarks += &paragraph(text);
        }
        if !remarks.is_empty() {
            page += &section("Remarks", &remarks);
        }
        let statements: String = [ONLY_THE_ITEM, WHY_NO_PARAMETERS, IN_FULL].map(paragraph).concat();
        page += &section("Statements", &statements);
        page += &self.authorization();
        page += &self.identification_of_data();
        page + "<p class=\"end\">End of the certificate</p>\n"
    }

    fn identity(&self) -> String {
        let (laboratory, item) = (&self.laboratory, &self.laboratory.item);
        let own = &laboratory.laboratory;
        let mut parties = vec![
            ("Certificate number", stated(laboratory.certificate.number.as_ref())),
            ("Laboratory", address(own)),
        ];
        if let Some(accreditation) = &own.accreditation {
            parties.push(("Accreditation", escaped(accreditation)));
        }
        parties.push(("Customer", address(&laboratory.customer)));
        let mut facts = vec![
            ("Item", stated(item.description.as_ref())),
            ("Manufacturer", stated(item.manufacturer.as_ref())),
            ("Type", stated(item.model.as_ref())),
            ("Serial number", stated(item.serial_number.as_ref())),
        ];
        if let Some(condition) = &item.condition {
            facts.push(("Condition", escaped(condition)));
        }
        let calibration = &laboratory.calibration;
        let days = match (&calibration.begun, &calibration.ended) {
            (Some(begun), Some(ended)) if begun == ended => escaped(begun),
            (begun, ended) => format!("{} to {}", stated(begun.as_ref()), stated(ended.as_ref())),
        };
        let detail = calibration.place_detail.as_ref().map(|text| format!(", {}", escaped(text)));
        let dates = [
            ("Date of receipt", stated(item.received.as_ref())),
            ("Date of calibration", days),
            ("Date of issue", stated(laboratory.certificate.issued.as_ref())),
            ("Place of calibration", stated(calibration.place.as_ref()) + &detail.unwrap_or_default()),
        ];
        section("", &rows(&parties))
            + &section("Item", &rows(&facts))
            + &section("Dates and place", &rows(&dates))
    }

    fn measurement(&self) -> String {
        let (reference, environment) = (&self.laboratory.reference, &self.laboratory.environment);
        let mut method = vec![("Measurand", escaped(&self.measurand())), ("Method", escaped(&self.method()))];
        if let Some(procedure) = &self.laboratory.calibration.procedure {
            method.push(("Procedure", escaped(procedure)));
        }
        let traceability = [
            ("Reference", stated(reference.description.as_ref())),
            ("Serial number", stated(reference.serial_number.as_ref())),
            (
                "Certificate",
                format!(
                    "{}, issued by {}",
                    stated(reference.certificate.as_ref()),
                    stated(reference.certificate_by.as_ref())
                ),
            ),
            ("Traceability", stated(reference.traceability.as_ref())),
        ];
        let mut conditions = vec![("Temperature of the air", span(environment.temperature_c, "°C"))];
        for (name, range, unit) in [
            ("Relative humidity", environment.humidity_percent, "%"),
            ("Pressure of the air", environment.pressure_hpa, "hPa"),
        ] {
            if range.is_some() {
                conditions.push((name, span(range, unit)));
            }
        }
        section("Measurand and method", &rows(&method))
            + &section("Metrological traceability", &rows(&traceability))
            + &section("Environmental conditions", &rows(&conditions))
    }

    fn results(&self) -> String {
        let findings = &self.findings;
        let mut table = "<table class=\"numbers\"><thead><tr><th></th>".to_owned();
        for (axis, unit) in AXES {
            let unit = if unit == "um" { "µm" } else { "µrad" };
            let _ = write!(table, "<th>{axis}<br>{unit}</th>");
        }
        table += "</tr></thead><tbody>\n";
        let errors = |values: &Option<_>| match values {
            Some(values) => six(values).map(|x| format!("{x:.3}")),
            None => AXES.map(|_| "–".to_owned()),
        };
        let held_out = format!(
            "After adjustment: calibrated head against the reference, rms of {} points held out",
            findings.held_out.poses
        );
        let optional =
            |values: [Option<f64>; 6], show: fn(f64) -> String| values.map(|x| x.map_or(GAP.into(), show));
        let expanded = format!("Expanded uncertainty U (k = {COVERAGE_FACTOR})");
        for (name, cells, class) in [
            ("Before adjustment: nominal head against the reference, rms", errors(&findings.before), ""),
            (&held_out, errors(&findings.after), ""),
            (
                "Standard uncertainty by the calibration, largest over the range",
                self.by_calibration().map(|x| format!("{x:.3}")),
                "",
            ),
            (
                "Standard uncertainty of the reference, common to all points",
                optional(self.by_reference(), |x| format!("{x:.3}")),
                "",
            ),
            (
                "Remaining error of the pose, all corrections applied",
                AXES.map(|_| "0".to_owned()),
                " class=\"result\"",
            ),
            (&expanded, optional(self.expanded(), rounded_up), " class=\"result\""),
        ] {
            let _ = write!(table, "<tr{class}><th>{name}</th>");
            for cell in cells {
                let _ = write!(table, "<td>{cell}</td>");
            }
            table += "</tr>\n";
        }
        table += "</tbody></table>\n";
        let held_out = self.held_out_chi2().map_or("none".to_owned(), |x| format!("{x:.2}"));
        let [a, b, c] = self.range.covered.map(|part| format!("{:.1} %", 100.0 * part));
        let facts = [
            ("Range", format!("±{} mm, ±{} mrad on each axis", self.header.range_mm, self.header.range_mrad)),
            ("Covered by readings", format!("{a}, {b}, {c} of the spots of this range on PSDs A, B, C")),
            (
                "Agreement with the data",
                format!(
                    "chi-square per row {:.2} ({} rows, {} dropped as gross errors); of {} points held out: {held_out}",
                    findings.chi2_per_row,
                    findings.rows,
                    findings.dropped.len(),
                    findings.held_out.points
                ),
            ),
        ];
        let missing = if findings.before.is_none() || findings.after.is_none() {
            paragraph("–: too few points have a reference of all six coordinates.")
        } else {
            String::new()
        };
        let note = paragraph(
            "Differences from the reference contain the standard uncertainty of the reference at each point.",
        );
        section("Results", &(rows(&facts) + &table + &missing + &note))
    }

    fn authorization(&self) -> String {
        let persons = &self.laboratory.certificate.authorized_by;
        let line = |name: String, function: String| format!("<div>{name}<br>{function}</div>");
        let mut lines: String = persons
            .iter()
            .map(|person| line(stated(person.name.as_ref()), stated(person.function.as_ref())))
            .collect();
        if persons.is_empty() {
            lines = line(GAP.to_owned(), String::new());
        }
        section("Authorized by", &format!("<div class=\"sign\">{lines}</div>\n"))
    }

    fn identification_of_data(&self) -> String {
        let hash = |text: &str| format!("<span class=\"hash\">{}</span>", escaped(text));
        let mut facts =
            vec![("Fingerprint of the calibrated configuration".to_owned(), hash(&self.header.fits))];
        facts.extend(self.files.iter().map(|file| (file.name.clone(), hash(&file.sha256))));
        facts.extend(self.findings.inputs.iter().map(|input| {
            let name = std::path::Path::new(&input.path).file_name().unwrap_or_default().to_string_lossy();
            (format!("{name}, {} rows, measured", input.rows), hash(&input.sha256))
        }));
        let facts: Vec<(&str, String)> =
            facts.iter().map(|(name, hash)| (name.as_str(), hash.clone())).collect();
        section("Identification of configuration, tables and data (SHA-256)", &rows(&facts))
    }
}

fn stated(text: Option<&String>) -> String {
    text.map_or(GAP.to_owned(), |text| escaped(text).replace('\n', "<br>"))
}

fn span(range: Option<[f64; 2]>, unit: &str) -> String {
    match range {
        Some([low, high]) => format!("{low} {unit} to {high} {unit}"),
        None => GAP.to_owned(),
    }
}

fn address(party: &Party) -> String {
    let part = |text: &Option<String>| stated(text.as_ref());
    format!(
        "{}<br>{}<br>{} {}, {}",
        part(&party.name),
        part(&party.street),
        part(&party.post_code),
        part(&party.city),
        part(&party.country)
    )
}

fn section(title: &str, content: &str) -> String {
    let title = if title.is_empty() { String::new() } else { format!("<h2>{title}</h2>\n") };
    format!("<section>{title}{content}</section>\n")
}

fn paragraph(text: &str) -> String {
    format!("<p>{}</p>\n", escaped(text).replace('\n', "<br>"))
}

/// Names, which are escaped here, with their values, which are HTML.
fn rows(facts: &[(&str, String)]) -> String {
    let mut table = "<table class=\"facts\">\n".to_owned();
    for (name, value) in facts {
        let _ = writeln!(table, "<tr><th>{}</th><td>{value}</td></tr>", escaped(name));
    }
    table + "</table>\n"
}
