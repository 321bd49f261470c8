//! The report as a page: prints on A4, needs no script, follows the light or dark theme of the reader.

use std::fmt::Write as _;

use trifacet_optics::FACETS;

use super::pictures::{self, AXES};
use super::{DroppedRow, Errors, Report, escaped};
use crate::calibration::{InputFile, ParameterReport};

const STYLE: &str = include_str!("style.css");

impl Report {
    /// The report as a page that prints.
    pub fn html(&self) -> String {
        let mut page = format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
             content=\"width=device-width\"><title>Calibration of the head</title>\n<style>\n{STYLE}</style></head>\
             <body>\n<h1>Calibration of the head</h1>\n<p class=\"verdict\">{}.</p>\n<p>Measured: {}.</p>\n",
            escaped(&self.verdict),
            escaped(&self.method)
        );
        for warning in &self.warnings {
            let _ = writeln!(page, "<p class=\"warning\">Warning: {}.</p>", escaped(warning));
        }
        page += &self.poses();
        page += &self.held_out_pictures();
        page += &self.coverage_pictures();
        page += &self.tests();
        page += &self.dropped_rows();
        page += &self.parameter_table();
        page += &self.files();
        page + "</body></html>\n"
    }

    fn poses(&self) -> String {
        let mut text = "<section><h2>Poses before and after</h2>\n<p>Errors at the apex, relative to the zero of the \
                        reference, root mean square.</p>\n<table><thead><tr><th></th><th>tx, um</th><th>ty, um</th>\
                        <th>tz, um</th><th>roll, urad</th><th>pitch, urad</th><th>yaw, urad</th></tr></thead>\n"
            .to_owned();
        let rows = [
            ("before: nominal head against the reference", self.before),
            ("after: calibrated head on points held out", self.after),
            ("standard uncertainty over the range by the calibration", Some(self.std)),
        ];
        for (name, errors) in rows {
            let Some(Errors { um, urad }) = errors else { continue };
            let cells: Vec<String> = um.iter().chain(&urad).map(|x| format!("<td>{x:.3}</td>")).collect();
            let _ = writeln!(text, "<tr><td>{name}</td>{}</tr>", cells.concat());
        }
        text + "</table>\n<p>The errors of the points held out contain the noise of the reference and of the \
                readings.</p></section>\n"
    }

    fn held_out_pictures(&self) -> String {
        let poses = &self.held_out_poses;
        if poses.is_empty() {
            return "<section><h2>Errors of the points held out</h2>\n<p>No point that was held out has a reference of \
                    all axes.</p></section>\n"
                .to_owned();
        }
        let std = self.std.um.into_iter().chain(self.std.urad);
        let panels: Vec<String> = (0..AXES.len())
            .zip(std)
            .map(|(axis, std)| format!("<figure>{}</figure>", pictures::errors(axis, poses, std)))
            .collect();
        let scale = pictures::arrow_scale(poses);
        let maps: Vec<String> = (0..3)
            .map(|psd| {
                let map = pictures::arrows(psd, &self.coverage[psd], poses, scale);
                format!("<figure>{map}<figcaption>PSD {}</figcaption></figure>", FACETS[psd])
            })
            .collect();
        format!(
            "<section><h2>Errors of the points held out</h2>\n<p>Each of {} points against the pose on the same axis. \
             The band is twice the standard uncertainty over the range by the calibration.</p>\n\
             <div class=\"three\">{panels}</div></section>\n\
             <section><h2>The same errors on the PSDs</h2>\n<p>Each error of a pose as the displacements of the three \
             spots that would cause it. Arrows that resemble their neighbours show an error of the PSD that the fit \
             has not followed. {}</p>\n<div class=\"three\">{maps}</div></section>\n",
            poses.len(),
            pictures::arrow_legend(scale),
            panels = panels.concat(),
            maps = maps.concat()
        )
    }

    fn coverage_pictures(&self) -> String {
        let maps: Vec<String> = (0..3)
            .map(|psd| {
                let map = pictures::coverage(psd, &self.coverage[psd]);
                format!(
                    "<figure>{map}<figcaption>PSD {}: {:.1} % of the spots of the range are covered</figcaption>\
                     </figure>",
                    FACETS[psd],
                    100.0 * self.covered[psd]
                )
            })
            .collect();
        format!(
            "<section><h2>Coverage of the PSDs</h2>\n<p>Spots of the <span class=\"key point\">points</span> and of the \
             <span class=\"key scan\">scans</span>; <span class=\"key covered\">covered area</span>. A pose with a spot \
             outside of this area is marked OUT_OF_CALIBRATION.</p>\n<div class=\"three\">{}</div></section>\n",
            maps.concat()
        )
    }

    fn tests(&self) -> String {
        let mut text = format!(
            "<section><h2>Tests</h2>\n<table><thead><tr><th>test</th><th>result</th><th>expected</th></tr></thead>\n\
             <tr><td>chi-square per row, {} rows</td><td>{:.3}</td><td>0.6 to 1.2</td></tr>\n",
            self.rows, self.chi2_per_row
        );
        if self.held_out.rows > 0 {
            let _ = writeln!(
                text,
                "<tr><td>chi-square per row, {} points held out</td><td>{:.3}</td><td>0.7 to 1.4</td></tr>",
                self.held_out.points,
                self.held_out.per_row()
            );
        }
        let [x, y] = self.steering_um;
        let _ = writeln!(
            text,
            "<tr><td>residual of the steering along x and y, rms</td><td>{x:.3} um, {y:.3} um</td><td>noise of the \
             readback</td></tr>"
        );
        text + "</table></section>\n"
    }

    fn dropped_rows(&self) -> String {
        let mut text = "<section><h2>Rows that were dropped</h2>\n".to_owned();
        if self.dropped.is_empty() {
            return text + "<p>None.</p></section>\n";
        }
        text += "<table><thead><tr><th>file</th><th>line</th><th class=\"words\">reason</th></tr></thead>\n";
        for DroppedRow { file, line, reason } in &self.dropped {
            let (file, reason) = (escaped(file), escaped(reason));
            let _ =
                writeln!(text, "<tr><td>{file}</td><td>{line}</td><td class=\"words\">{reason}</td></tr>");
        }
        text + "</table></section>\n"
    }

    fn parameter_table(&self) -> String {
        let mut text = "<section class=\"long\"><h2>Parameters</h2>\n<p>Differences from the head as drawn. The bar \
                        divides the variance that the tolerance allows: removed by <span class=\"key data\">data\
                        </span>, left because the data do not tell (<span class=\"key tolerance\">tolerance</span>), \
                        left because no measurement can tell (<span class=\"key convention\">convention</span>). \
                        Changes by convention have no effect on a pose: never compare parameters with each other or \
                        with a drawing, compare poses.</p>\n<table><thead><tr><th>parameter</th><th>unit</th>\
                        <th>value</th><th>tolerance</th><th>standard uncertainty</th><th class=\"words\">determined by\
                        </th></tr></thead>\n"
            .to_owned();
        for p in &self.parameters {
            let ParameterReport { name, unit, value, prior, posterior, determined_by, shares } = p;
            let (unit, factor) = match unit.as_str() {
                "m" => ("um", 1e6),
                "rad" => ("urad", 1e6),
                _ => ("%", 1e2),
            };
            let decimals = decimals(posterior * factor);
            let [value, prior, posterior] =
                [value, prior, posterior].map(|x| format!("<td>{:.decimals$}</td>", x * factor));
            let bar = pictures::bar([shares.data, shares.tolerance, shares.convention]);
            let _ = writeln!(
                text,
                "<tr><td>{name}</td><td>{unit}</td>{value}{prior}{posterior}<td class=\"words\">{bar} {determined_by}\
                 </td></tr>"
            );
        }
        text + "</table></section>\n"
    }

    fn files(&self) -> String {
        let mut text = "<section><h2>Files</h2>\n<table><thead><tr><th>file</th><th>kind</th><th>rows</th>\
                        <th class=\"words\">SHA-256</th></tr></thead>\n"
            .to_owned();
        for InputFile { path, kind, rows, sha256 } in &self.inputs {
            let path = escaped(&path.display().to_string());
            let _ = writeln!(
                text,
                "<tr><td>{path}</td><td>{kind}</td><td>{rows}</td><td class=\"words\"><code>{sha256}</code></td></tr>"
            );
        }
        text + "</table></section>\n"
    }
}

/// Decimals that show two digits of a standard uncertainty.
fn decimals(deviation: f64) -> usize {
    if deviation > 0.0 { (1.0 - deviation.log10().floor()).clamp(0.0, 6.0) as usize } else { 3 }
}
