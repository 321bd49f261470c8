//! Texts and tables of the report.

use std::fmt::Write;

use trifacet_wire::Status;

use super::Report;
use super::cells::{escaped, micro, paper, percent, seconds, table, with_sigma};
use crate::config::Axis;
use crate::experiment::static_record::StaticRecord;
use crate::experiment::statistics::Measured;

/// 95 % of a normal distribution lie within this number of standard deviations.
pub(super) const WITHIN_95: f64 = 1.96;
/// A slope that differs from its ideal value by more than this number of standard uncertainties is marked.
const MARKED: f64 = 3.0;

/// Nanoseconds from 1970 to 2000.
const YEAR_2000_NS: i64 = 946_684_800_000_000_000;

/// The page without style, script and data.
pub(super) fn page(report: &Report, template: &str) -> String {
    let averaged = match report.averaged[0] {
        0 | 1 => String::new(),
        n => format!(", or here the mean over {n} samples"),
    };
    let simulated = "<p class=\"note\">The light is simulated by the digital twin: the results describe the model and the software, not a real head.</p>";
    template
        .replace("{{source}}", &escaped(&report.source))
        .replace("{{what}}", &what(report))
        .replace("{{simulated}}", if report.simulated { simulated } else { "" })
        .replace("{{table2}}", &table2(&report.table2))
        .replace("{{figures}}", &figures(&report.table2))
        .replace("{{bound}}", &bound(&report.table2))
        .replace("{{crosstalk}}", &crosstalk(&report.table2))
        .replace("{{rest}}", &report.rest.as_ref().map_or_else(String::new, at_rest))
        .replace("{{beyond}}", &beyond(report))
        .replace("{{averaged}}", &averaged)
}

fn unit(axis: Axis) -> &'static str {
    super::unit(axis.is_turn())
}

fn named(axis: Axis) -> String {
    format!("{}, {}", axis.name(), unit(axis))
}

/// Number of readings, their times, and the status bits that occurred.
fn what(report: &Report) -> String {
    let all = &report.table2;
    let points: usize = all.iter().map(|m| m.points.len()).sum();
    let readings: usize = all.iter().flat_map(|m| &m.points).map(|p| p.readings).sum();
    let axes = if all.len() == 1 { "1 axis".into() } else { format!("{} axes", all.len()) };
    let known = Status::POSE_VALID | Status::SIMULATED | Status::STEERING_MEASURED;
    let remarks: Vec<_> = Status(report.status.0 & !known.0).names().collect();
    let remarks =
        if remarks.is_empty() { String::new() } else { format!(" Status: {}.", remarks.join(", ")) };
    format!("{axes}, {points} points, {readings} readings{}.{remarks}", when(report.time_ns))
}

/// Start and end of the measurement. Empty for the twin, which counts from its own start.
fn when(time_ns: [i64; 2]) -> String {
    let moment =
        |ns: i64| jiff::Timestamp::from_nanosecond(ns.into()).ok().map(|t| t.strftime("%F %H:%M:%S"));
    match time_ns.map(moment) {
        [Some(first), Some(last)] if time_ns[0] > YEAR_2000_NS => format!(", {first} to {last} UTC"),
        _ => String::new(),
    }
}

fn table2(all: &[Measured]) -> String {
    let head = [
        "axis",
        "range",
        "interval",
        "σ measured",
        "σ of the paper",
        "σ predicted",
        "measured / predicted",
        "relative uncertainty",
        "of the paper",
        "noise alone",
    ];
    let row = |m: &Measured| {
        let printed = m.printed();
        vec![
            named(m.axis),
            micro(m.range),
            micro(m.interval),
            format!("<b>{}</b>", micro(m.std)),
            paper(&format!("{:.2}", printed.std)),
            micro(m.predicted),
            format!("{:.3}", m.std / m.predicted),
            percent(m.relative),
            paper(&format!("{} %", printed.relative)),
            percent(m.relative_noise),
        ]
    };
    table(&head, all.iter().map(row))
}

fn figures(all: &[Measured]) -> String {
    let mut html = String::new();
    for (i, m) in all.iter().enumerate() {
        let (name, figure) = (m.axis.name(), m.printed().figure);
        let chart = |kind: &str, label: &str| {
            format!(
                "<div class=\"chart\" data-kind=\"{kind}\" data-axis=\"{i}\" role=\"img\" aria-label=\"{name}: {label}\"></div>"
            )
        };
        let _ = writeln!(
            html,
            "<div class=\"pair\"><h3>Figure {figure}: {name} <small>σ measured {} {u}, paper {:.2} {u}</small></h3>{}{}</div>",
            micro(m.std),
            m.printed().std,
            chart("displacement", "measured against reference"),
            chart("errors", "errors against reference"),
            u = unit(m.axis),
        );
    }
    html
}

fn bound(all: &[Measured]) -> String {
    let row = |m: &Measured| {
        let ratio = m.pooled / m.predicted;
        vec![
            named(m.axis),
            micro(m.pooled),
            micro(m.predicted),
            format!("{ratio:.3} ± {:.3}", WITHIN_95 * ratio * m.pooled_part),
            paper(&format!("{:.2}", m.printed().std)),
            format!("{:.3}", m.printed().std / (m.predicted * 1e6)),
        ]
    };
    let head =
        ["axis", "σ of all points", "bound", "over the bound, 95 %", "σ of the paper", "over the bound"];
    table(&head, all.iter().map(row))
}

fn crosstalk(all: &[Measured]) -> String {
    let row = |m: &Measured| {
        let cell = |axis: Axis| {
            let slope = m.response[axis as usize];
            let right = if axis == m.axis { 1.0 } else { 0.0 };
            // The uncertainty is on its own line, because seven columns would otherwise be too wide.
            let text = with_sigma(slope.value, slope.sigma).replace(" <small>", "<br><small>");
            let marked = (slope.value - right).abs() > MARKED * slope.sigma;
            if marked { format!("<b>{text}</b>") } else { text }
        };
        [vec![named(m.axis)], Axis::ALL.map(cell).to_vec()].concat()
    };
    let head = Axis::ALL.map(named);
    let head = [vec!["moved"], head.iter().map(String::as_str).collect()].concat();
    table(&head, all.iter().map(row))
}

fn at_rest(rest: &StaticRecord) -> String {
    let row = |(axis, still): (Axis, &crate::experiment::static_record::Still)| {
        let least = still.allan.iter().min_by(|a, b| a.deviation.total_cmp(&b.deviation));
        let (first, last) = (still.allan.first(), still.allan.last());
        let deviation =
            |a: Option<&crate::experiment::allan::Allan>| a.map_or("-".into(), |a| micro(a.deviation));
        let white = |n: usize| still.stated / (n as f64).sqrt();
        let hour = 3600e6;
        vec![
            named(axis),
            deviation(first),
            micro(still.stated),
            deviation(last),
            last.map_or("-".into(), |a| micro(white(a.n))),
            least.map_or("-".into(), |a| seconds(a.n as f64 * rest.period_s)),
            with_sigma(hour * still.drift.value, hour * still.drift.sigma),
        ]
    };
    let longest = rest.axes[0].allan.last().map_or(0.0, |a| a.n as f64 * rest.period_s);
    let [first, last] = [rest.period_s, longest].map(|s| format!("Allan, {}", seconds(s)));
    let head = ["axis", &first, "predicted", &last, "white noise", "minimum at", "drift per hour"];
    let chart = |kind: &str, axis: u8, label: &str| {
        format!(
            "<div class=\"chart\" data-kind=\"{kind}\" data-axis=\"{axis}\" role=\"img\" aria-label=\"{label}\"></div>"
        )
    };
    let allan = match &rest.uneven {
        Some(why) => format!("</p>\n<p class=\"note\">No Allan deviation: {why}.</p>"),
        None => format!(
            " Dotted: white noise with the predicted standard uncertainty, σ/√n. Bars: standard uncertainty of the Allan deviation.</p>\n<div class=\"pair\">{}{}</div>",
            chart("allan", 0, "Allan deviation of the translations"),
            chart("allan", 3, "Allan deviation of the rotations"),
        ),
    };
    format!(
        "<section>\n<h2>At rest: Allan deviation and drift</h2>\n<p>{} readings in {} with the mirror at rest.{allan}\n<div class=\"pair\"><h3>Over time <small>means over {}</small></h3>{}{}</div>\n{}</section>\n",
        rest.readings,
        seconds(rest.span_s + rest.period_s),
        seconds((rest.span_s + rest.period_s) / rest.times_s.len() as f64),
        chart("course", 0, "translations over time"),
        chart("course", 3, "rotations over time"),
        table(&head, Axis::ALL.into_iter().zip(&rest.axes).map(row)),
    )
}

fn beyond(report: &Report) -> String {
    if report.beyond.is_empty() {
        return String::new();
    }
    let row = |m: &Measured| {
        vec![
            named(m.axis),
            format!("<b>{}</b>", micro(m.std)),
            micro(m.predicted),
            paper(&format!("{:.2}", m.printed().std)),
            format!("{:.0} times", m.printed().std / (m.std * 1e6)),
            percent(m.relative),
            paper(&format!("{} %", m.printed().relative)),
        ]
    };
    let head = [
        "axis",
        "σ measured",
        "σ predicted",
        "σ of the paper",
        "less noise",
        "relative uncertainty",
        "of the paper",
    ];
    format!(
        "<section>\n<h2>Beyond the paper</h2>\n<p>The same protocol with components that are available today: an 18-bit converter, spots with 0.57 µm of noise \
         (about half of the 1.08 µm that explain the noise in the paper), and {} samples averaged into each reading.</p>\n{}</section>\n",
        report.averaged[1],
        table(&head, report.beyond.iter().map(row)),
    )
}
