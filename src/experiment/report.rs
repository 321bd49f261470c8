//! The report: a single HTML file without external resources.

mod cells;
mod html;

use serde_json::{Value, json};
use trifacet_wire::Status;

use super::reading::{Part, Reading};
use super::static_record::StaticRecord;
use super::statistics::{Measured, measured};
use crate::charts;
use crate::exit::{self, Failure};

const PAGE: &str = include_str!("assets/report.html");
const STYLE: &str = include_str!("assets/report.css");
const SCRIPT: &str = include_str!("assets/report.js");

/// All results of the readings.
#[derive(Clone, Debug)]
pub struct Report {
    /// Description of the source.
    pub source: String,
    /// The results for Table 2 of the paper.
    pub table2: Vec<Measured>,
    /// The results beyond the paper; may be empty.
    pub beyond: Vec<Measured>,
    /// The record at rest, if there is one.
    pub rest: Option<StaticRecord>,
    /// Whether the readings are from the twin.
    pub simulated: bool,
    /// All status bits that occur in the readings.
    status: Status,
    /// Times of the first and the last reading, nanoseconds.
    time_ns: [i64; 2],
    /// Number of samples per reading, of both parts.
    averaged: [u32; 2],
}

impl Report {
    /// Evaluates readings.
    ///
    /// # Errors
    /// Fails if there are too few readings, or if they do not belong together.
    pub fn new(readings: &[Reading], source: String) -> Result<Self, Failure> {
        let table2 = measured(readings, Part::Table2)?;
        if table2.is_empty() {
            return Err(Failure::new(exit::DATA, "there are no readings of the part table2"));
        }
        let averaged = |part| readings.iter().find(|r| r.part == part).map_or(0, |r| r.look.averaged);
        let status = readings.iter().fold(Status::default(), |all, r| all | r.look.status);
        let times = || readings.iter().map(|r| r.look.time_ns);
        Ok(Self {
            source,
            table2,
            beyond: measured(readings, Part::Beyond)?,
            rest: StaticRecord::of(readings)?,
            simulated: status.has(Status::SIMULATED),
            status,
            time_ns: [times().min().unwrap_or(0), times().max().unwrap_or(0)],
            averaged: [averaged(Part::Table2), averaged(Part::Beyond)],
        })
    }

    /// The report as HTML.
    pub fn html(&self) -> String {
        // The library is inserted last, so that it is not searched for placeholders.
        html::page(self, PAGE)
            .replace("{{style}}", &[charts::STYLE, STYLE].concat())
            .replace("{{script}}", SCRIPT)
            .replace("{{data}}", &self.data().to_string())
            .replacen("{{plot}}", charts::PLOT, 1)
            .replacen("{{uplot}}", charts::UPLOT, 1)
    }

    /// The data of the figures, in um, urad and seconds.
    fn data(&self) -> Value {
        json!({
            "axes": self.table2.iter().map(figure).collect::<Vec<_>>(),
            "bound": bound(&self.table2),
            "rest": self.rest.as_ref().map(at_rest),
        })
    }
}

fn micro(values: impl Iterator<Item = f64>) -> Vec<f64> {
    values.map(|x| x * 1e6).collect()
}

fn unit(turn: bool) -> &'static str {
    if turn { "µrad" } else { "µm" }
}

fn figure(m: &Measured) -> Value {
    let i = m.axis as usize;
    json!({
        "unit": unit(m.axis.is_turn()),
        "paper_std": m.printed().std,
        "reference": micro(m.points.iter().map(|p| p.reference)),
        "measured": micro(m.points.iter().map(|p| p.means[i] - m.offset)),
        "error": micro(m.points.iter().map(|p| m.error(p))),
        "std": micro(m.points.iter().map(|p| p.std)),
        "low": micro(m.points.iter().map(|p| p.min - p.reference - m.offset)),
        "high": micro(m.points.iter().map(|p| p.max - p.reference - m.offset)),
    })
}

fn bound(all: &[Measured]) -> Value {
    let ratio = |m: &Measured| m.pooled / m.predicted;
    json!({
        "names": all.iter().map(|m| m.axis.name()).collect::<Vec<_>>(),
        "ratio": all.iter().map(ratio).collect::<Vec<_>>(),
        "half": all.iter().map(|m| ratio(m) * html::WITHIN_95 * m.pooled_part).collect::<Vec<_>>(),
        "paper": all.iter().map(|m| m.printed().std / (m.predicted * 1e6)).collect::<Vec<_>>(),
    })
}

fn at_rest(rest: &StaticRecord) -> Value {
    let axis = |(axis, still): (crate::config::Axis, &super::static_record::Still)| {
        json!({
            "name": axis.name(),
            "unit": unit(axis.is_turn()),
            "allan": micro(still.allan.iter().map(|a| a.deviation)),
            "part": still.allan.iter().map(|a| a.part).collect::<Vec<_>>(),
            "stated": still.stated * 1e6,
            "course": micro(still.course.iter().copied()),
        })
    };
    json!({
        "tau": rest.axes[0].allan.iter().map(|a| a.n as f64 * rest.period_s).collect::<Vec<_>>(),
        "times": rest.times_s,
        "axes": crate::config::Axis::ALL.into_iter().zip(&rest.axes).map(axis).collect::<Vec<_>>(),
    })
}
