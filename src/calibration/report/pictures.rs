//! Pictures of a report, as SVG without a script. Colours are those of the classes in the style of the page.

use std::fmt::Write as _;

use trifacet_optics::FACETS;

use super::{Coverage, HeldOutPose};

/// Side of a picture, without its labels, pixels.
const SIDE: f64 = 260.0;
/// Room for labels on the left and below, pixels.
const MARGIN: f64 = 34.0;
/// Height of a picture of errors along an axis.
const HEIGHT: f64 = 130.0;
/// Length of the root mean square arrow, pixels.
const ARROW: f64 = 14.0;
/// Longest arrow, pixels: longer ones are cut off.
const LONGEST: f64 = 60.0;

/// A picture with its axes; `draw` adds what lies in it.
fn frame(name: &str, size: [f64; 2], labels: &[(f64, f64, &str, String)], draw: &str) -> String {
    let [width, height] = size;
    let mut text = format!(
        "<svg viewBox=\"0 0 {:.0} {:.0}\" role=\"img\" aria-label=\"{name}\">\
         <rect class=\"frame\" x=\"{MARGIN}\" y=\"8\" width=\"{width}\" height=\"{height}\"/>",
        width + MARGIN + 8.0,
        height + MARGIN + 8.0
    );
    text += draw;
    for (x, y, anchor, label) in labels {
        let _ = write!(text, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{label}</text>");
    }
    text + "</svg>"
}

/// Places on a PSD as pixels: u to the right, v upwards.
struct Face {
    half: f64,
}

impl Face {
    fn at(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let scale = SIDE / (2.0 * self.half);
        [MARGIN + (u + self.half) * scale, 8.0 + (self.half - v) * scale]
    }

    /// Numbers along both axes, every 2 mm.
    fn labels(&self) -> Vec<(f64, f64, &'static str, String)> {
        let mut labels = Vec::new();
        let last = (self.half / 2.0).floor() as i32 * 2;
        for mm in (-last..=last).step_by(2) {
            let [x, y] = self.at([f64::from(mm); 2]);
            labels.push((x, SIDE + 22.0, "middle", mm.to_string()));
            labels.push((MARGIN - 5.0, y + 4.0, "end", mm.to_string()));
        }
        labels.push((MARGIN + SIDE, SIDE + 37.0, "end", "u, mm".into()));
        labels.push((4.0, SIDE + 37.0, "start", "v, mm".into()));
        labels
    }

    fn picture(&self, name: &str, coverage: &Coverage, draw: &str) -> String {
        let side = coverage.cell_mm * SIDE / (2.0 * self.half);
        let mut cells = String::new();
        for [u, v] in &coverage.covered_mm {
            let [x, y] = self.at([*u, v + coverage.cell_mm]);
            let _ = write!(cells, "M{x:.1} {y:.1}h{side:.2}v{side:.2}h-{side:.2}z");
        }
        let id = name.to_lowercase().replace(' ', "-");
        let clip = format!(
            "<clipPath id=\"{id}\"><rect x=\"{MARGIN}\" y=\"8\" width=\"{SIDE}\" height=\"{SIDE}\"/></clipPath>\
             <g clip-path=\"url(#{id})\"><path class=\"covered\" d=\"{cells}\"/>{draw}</g>"
        );
        frame(name, [SIDE; 2], &self.labels(), &clip)
    }
}

/// Where the spots fell on a PSD, and the covered area.
pub(super) fn coverage(psd: usize, coverage: &Coverage) -> String {
    let face = Face { half: coverage.half_side_mm };
    let mut dots = String::new();
    for (class, spots) in [("point", &coverage.points_mm), ("scan", &coverage.scans_mm)] {
        let mut path = String::new();
        for spot in spots {
            let [x, y] = face.at(*spot);
            let _ = write!(path, "M{x:.1} {y:.1}h0");
        }
        let _ = write!(dots, "<path class=\"{class}\" d=\"{path}\"/>");
    }
    face.picture(&format!("Spots on PSD {}", FACETS[psd]), coverage, &dots)
}

/// Errors of the poses held out as displacements of the spots on a PSD. `scale`: pixels per micrometre.
pub(super) fn arrows(psd: usize, coverage: &Coverage, poses: &[HeldOutPose], scale: f64) -> String {
    let face = Face { half: coverage.half_side_mm };
    let mut drawn = String::new();
    for pose in poses {
        let [x, y] = face.at([pose.spots_mm[2 * psd], pose.spots_mm[2 * psd + 1]]);
        let [mut dx, mut dy] =
            [pose.spot_errors_um[2 * psd] * scale, -pose.spot_errors_um[2 * psd + 1] * scale];
        let length = dx.hypot(dy);
        if length > LONGEST {
            (dx, dy) = (dx * LONGEST / length, dy * LONGEST / length);
        }
        let _ = write!(drawn, "<circle class=\"tail\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"1.8\"/>");
        let _ = write!(drawn, "<path class=\"arrow\" d=\"M{x:.1} {y:.1}l{dx:.1} {dy:.1}\"/>");
    }
    let name = format!("Errors on PSD {}", FACETS[psd]);
    face.picture(&name, coverage, &drawn)
}

/// Pixels per micrometre of the arrows of all PSDs.
pub(super) fn arrow_scale(poses: &[HeldOutPose]) -> f64 {
    let all = poses.iter().flat_map(|pose| pose.spot_errors_um);
    let (sum, n) = all.fold((0.0, 0.0), |(sum, n), x| (sum + x * x, n + 1.0));
    let rms = (2.0 * sum / n).sqrt();
    if rms > 0.0 { ARROW / rms } else { 1.0 }
}

/// An arrow of a round length, with its length.
pub(super) fn arrow_legend(scale: f64) -> String {
    let length = round_up(20.0 / scale);
    let pixels = length * scale;
    format!(
        "<svg class=\"legend\" width=\"{0:.0}\" height=\"10\" viewBox=\"0 0 {0:.0} 10\"><circle class=\"tail\" cx=\"3\" \
         cy=\"5\" r=\"1.8\"/><path class=\"arrow\" d=\"M3 5h{pixels:.1}\"/></svg> {length} um",
        pixels + 6.0
    )
}

/// Errors of the poses held out along one axis, against the pose on this axis. `std`: standard uncertainty over the
/// range by the calibration.
pub(super) fn errors(axis: usize, poses: &[HeldOutPose], std: f64) -> String {
    let (name, unit) = (AXES[axis], UNITS[axis / 3]);
    let largest =
        |value: &dyn Fn(&HeldOutPose) -> f64| poses.iter().map(|p| value(p).abs()).fold(0.0, f64::max);
    let across = round_up(largest(&|p| p.reference[axis]) * 1e-3);
    let along = round_up(largest(&|p| p.error[axis]).max(2.2 * std));
    let (x, y) = (
        |value: f64| MARGIN + SIDE * (0.5 + value / (2.0 * across)),
        |value: f64| 8.0 + HEIGHT * (0.5 - value / (2.0 * along)),
    );
    let mut draw = format!(
        "<rect class=\"band\" x=\"{MARGIN}\" width=\"{SIDE}\" y=\"{:.1}\" height=\"{:.1}\"/>\
         <path class=\"zero\" d=\"M{MARGIN} {:.1}h{SIDE}\"/><path class=\"point held\" d=\"",
        y(2.0 * std),
        y(-2.0 * std) - y(2.0 * std),
        y(0.0)
    );
    for pose in poses {
        let _ = write!(draw, "M{:.1} {:.1}h0", x(pose.reference[axis] * 1e-3), y(pose.error[axis]));
    }
    draw += "\"/>";
    let left = MARGIN - 5.0;
    let labels = [
        (left, 18.0, "end", format!("{along}")),
        (left, y(0.0) + 4.0, "end", "0".into()),
        (left, HEIGHT + 8.0, "end", format!("-{along}")),
        (MARGIN, HEIGHT + 22.0, "start", format!("-{across}")),
        (x(0.0), HEIGHT + 22.0, "middle", "0".into()),
        (MARGIN + SIDE, HEIGHT + 22.0, "end", format!("{across}")),
        (x(0.0), HEIGHT + 37.0, "middle", format!("{name}, m{}", &unit[1..])),
        (4.0, HEIGHT + 37.0, "start", unit.to_owned()),
    ];
    frame(&format!("Errors of {name}"), [SIDE, HEIGHT], &labels, &draw)
}

pub(super) const AXES: [&str; 6] = ["tx", "ty", "tz", "roll", "pitch", "yaw"];
const UNITS: [&str; 2] = ["um", "urad"];

/// The parts of a variance as a bar.
pub(super) fn bar(parts: [f64; 3]) -> String {
    let mut text = "<svg class=\"bar\" width=\"90\" height=\"10\" viewBox=\"0 0 90 10\">".to_owned();
    let mut from = 0.0;
    for (class, part) in ["data", "tolerance", "convention"].into_iter().zip(parts) {
        let width = 90.0 * part;
        let _ = write!(text, "<rect class=\"{class}\" x=\"{from:.1}\" width=\"{width:.1}\" height=\"10\"/>");
        from += width;
    }
    text + "</svg>"
}

/// The next number of 1, 2, 5 times a power of ten.
fn round_up(x: f64) -> f64 {
    if !(x.is_finite() && x > 0.0) {
        return 1.0;
    }
    let power = 10_f64.powf(x.log10().floor());
    let digit =
        [1.0, 1.2, 1.5, 2.0, 3.0, 5.0, 6.0, 8.0, 10.0].into_iter().find(|d| d * power >= x * (1.0 - 1e-9));
    // Rounded to the digits that are shown.
    let rounded = digit.unwrap_or(10.0) * power;
    format!("{rounded:.2e}").parse().unwrap_or(rounded)
}
