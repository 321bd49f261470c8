//! Plots the responses as SVG: one panel per axis, with the mean over all steps and the fit.

use std::fmt::{Display, Write};

use trifacet::identification::findings::Findings;
use trifacet::identification::plan::Plan;
use trifacet::identification::record::AXES;
use trifacet::identification::response::Response;

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 300.0;
/// Margins of a panel: left, right, top, bottom.
const MARGIN: [f64; 4] = [72.0, 20.0, 44.0, 50.0];
const TITLE: f64 = 40.0;
/// Colours of the beam's x and y. They can be distinguished without colour, too: y is drawn hollow.
const COLOURS: [&str; 2] = ["#1f5fa8", "#c2571a"];

/// The plot as SVG text.
pub(super) fn svg(findings: &Findings, plan: &Plan) -> String {
    let height = TITLE + 2.0 * HEIGHT;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height}\" \
         viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" font-size=\"12\" fill=\"#222\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    let title = format!("Response of the beam to steps of {:.1} um", plan.step * 1e6);
    text(&mut out, WIDTH / 2.0, 26.0, "middle\" font-size=\"16", title);
    for (axis, response) in findings.responses.iter().enumerate() {
        let top = TITLE + axis as f64 * HEIGHT;
        Panel::new(response, top).draw(&mut out, AXES[axis], response);
    }
    out.push_str("</svg>\n");
    out
}

/// A panel and its ranges.
struct Panel {
    top: f64,
    /// Range of the time, milliseconds.
    time: [f64; 2],
    /// Range of the movement, micrometres.
    way: [f64; 2],
}

impl Panel {
    /// A panel for the part of a response that contains the movement.
    fn new(response: &Response, top: f64) -> Self {
        let ms = |i: usize| response.mean.get(i).map_or(0.0, |(t, _)| t * 1e3);
        let period = ms(1) - ms(0);
        let end = (response.delay + 8.0 * response.lag) * 1e3 + 4.0 * period;
        let last = ms(response.mean.len() - 1);
        let time = [(-0.25 * end).min(-3.0 * period).max(ms(0)), end.max(12.0 * period).min(last)];
        let shown = response.mean.iter().filter(|(t, _)| (time[0]..=time[1]).contains(&(t * 1e3)));
        let (mut low, mut high) = (0.0_f64, 0.0_f64);
        for way in shown.flat_map(|(_, way)| way.map(|w| w * 1e6)) {
            (low, high) = (low.min(way), high.max(way));
        }
        let room = 0.08 * (high - low).max(1e-6);
        Self { top, time, way: [low - room, high + room] }
    }

    fn x(&self, ms: f64) -> f64 {
        MARGIN[0] + (ms - self.time[0]) / (self.time[1] - self.time[0]) * (WIDTH - MARGIN[0] - MARGIN[1])
    }

    fn y(&self, um: f64) -> f64 {
        let part = (um - self.way[0]) / (self.way[1] - self.way[0]);
        self.top + HEIGHT - MARGIN[3] - part * (HEIGHT - MARGIN[2] - MARGIN[3])
    }

    fn draw(&self, out: &mut String, name: &str, response: &Response) {
        self.frame(out, name, response);
        let delay = self.x(response.delay * 1e3);
        let (top, bottom) = (self.y(self.way[1]), self.y(self.way[0]));
        line(out, [delay, top, delay, bottom], "stroke=\"#555\" stroke-dasharray=\"5 4\"");
        text(out, delay + 5.0, bottom - 8.0, "start\" fill=\"#555", "delay");
        for (k, colour) in COLOURS.into_iter().enumerate() {
            self.fit(out, response, k, colour);
            let fill = if k == 0 { colour } else { "white" };
            for (t, way) in
                response.mean.iter().filter(|(t, _)| (self.time[0]..=self.time[1]).contains(&(t * 1e3)))
            {
                let _ = writeln!(
                    out,
                    "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\" fill=\"{fill}\" stroke=\"{colour}\" stroke-width=\"1.2\"/>",
                    self.x(t * 1e3),
                    self.y(way[k] * 1e6)
                );
            }
            let at = self.x(self.time[1]) - 130.0 + 70.0 * k as f64;
            let legend = self.top + MARGIN[2] - 14.0;
            let _ = writeln!(
                out,
                "<circle cx=\"{at:.1}\" cy=\"{:.1}\" r=\"3.5\" fill=\"{fill}\" stroke=\"{colour}\" stroke-width=\"1.2\"/>",
                legend - 4.0
            );
            text(out, at + 8.0, legend, "start", format_args!("beam {}", AXES[k]));
        }
    }

    /// Draws the fitted curve of one direction of the beam.
    fn fit(&self, out: &mut String, response: &Response, k: usize, colour: &str) {
        let full = response.movement[k] * 1e6;
        let mut points = String::new();
        for i in 0..=400 {
            let ms = self.time[0] + (self.time[1] - self.time[0]) * f64::from(i) / 400.0;
            let _ = write!(points, "{:.1},{:.2} ", self.x(ms), self.y(full * response.shape(ms * 1e-3)));
        }
        let _ = writeln!(
            out,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\" opacity=\"0.75\"/>",
            points.trim_end()
        );
    }

    /// Draws grid, ticks, labels and heading.
    fn frame(&self, out: &mut String, name: &str, response: &Response) {
        let (left, right) = (self.x(self.time[0]), self.x(self.time[1]));
        let (bottom, top) = (self.y(self.way[0]), self.y(self.way[1]));
        let grid = "stroke=\"#e3e3e3\"";
        for (ms, label) in ticks(self.time) {
            line(out, [self.x(ms), bottom, self.x(ms), top], grid);
            text(out, self.x(ms), bottom + 17.0, "middle", label);
        }
        for (um, label) in ticks(self.way) {
            line(out, [left, self.y(um), right, self.y(um)], grid);
            text(out, left - 7.0, self.y(um) + 4.0, "end", label);
        }
        let _ = writeln!(
            out,
            "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" stroke=\"#888\"/>",
            right - left,
            bottom - top
        );
        let heading = format!(
            "axis {name}: delay {:.3} ms, lag {:.3} ms, mean of {} steps",
            response.delay * 1e3,
            response.lag * 1e3,
            response.used
        );
        text(out, left, self.top + MARGIN[2] - 14.0, "start\" font-weight=\"bold", heading);
        text(
            out,
            f64::midpoint(left, right),
            bottom + 36.0,
            "middle",
            "time after the sample on which the step was commanded, ms",
        );
        let (x, y) = (18.0, f64::midpoint(bottom, top));
        text(
            out,
            x,
            y,
            &format!("middle\" transform=\"rotate(-90 {x:.1} {y:.1})"),
            "movement of the beam, um",
        );
    }
}

fn line(out: &mut String, [x1, y1, x2, y2]: [f64; 4], style: &str) {
    let _ = writeln!(out, "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" {style}/>");
}

/// Draws a text. It must not contain characters that XML requires to be escaped.
fn text(out: &mut String, x: f64, y: f64, anchor: &str, what: impl Display) {
    let _ = writeln!(out, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{what}</text>");
}

/// Round numbers within a range, with their labels.
fn ticks([from, to]: [f64; 2]) -> Vec<(f64, String)> {
    let rough = (to - from) / 7.0;
    let decade = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|s| *s >= rough).unwrap_or(rough);
    let digits = (-step.log10().floor()).max(0.0) as usize;
    let first = (from / step).ceil() as i64;
    (first..=(to / step).floor() as i64)
        .map(|k| (k as f64 * step, format!("{:.digits$}", k as f64 * step)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within_the_range() {
        let labels = |range| ticks(range).into_iter().map(|(_, label)| label).collect::<Vec<_>>();
        assert_eq!(labels([-1.3, 6.2]), ["0", "2", "4", "6"]);
        assert_eq!(labels([-0.02, 0.113]), ["-0.02", "0.00", "0.02", "0.04", "0.06", "0.08", "0.10"]);
    }
}
