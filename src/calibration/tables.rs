//! Correction tables from a calibration.

use std::fmt::Write as _;

use trifacet_optics::FACETS;
use trifacet_optics::calibration::result::Calibration;

/// Distance of the points of a table, metres. Between them the table is interpolated linearly, which costs
/// 0.006 um with this pitch.
const PITCH: f64 = 0.1e-3;

/// The text of the correction table of a PSD (0, 1, 2). `date`: when it was calibrated.
pub fn table(calibration: &Calibration, psd: usize, date: &str) -> String {
    let half = calibration.layout.half_sizes[psd];
    let lattice = &calibration.layout.lattices[psd];
    let points = ((2.0 * half / PITCH).round() as usize).max(1) + 1;
    let place = |i: usize| half * (2.0 * i as f64 / (points - 1) as f64 - 1.0);
    let cells = lattice.cells();
    let knots = lattice.knots();
    let bounds = |k: usize| {
        let all = cells.iter().map(|cell| cell[k]);
        let (low, high) = (all.clone().min().unwrap_or(0), all.max().unwrap_or(-1) + 1);
        (f64::from(low) * knots * 1e3, f64::from(high) * knots * 1e3)
    };
    let ((u0, u1), (v0, v1)) = (bounds(0), bounds(1));
    let name = FACETS[psd];
    let mut text = format!(
        "# Correction table of PSD {name}, calibrated {date}. Metres.\n\
         # At the reading (u, v) the spot is at (u + du, v + dv).\n\
         # Readings of the calibration lie in u = {u0:.2} to {u1:.2} mm, v = {v0:.2} to {v1:.2} mm, in the places \
         that column `covered` marks by 1.\n\
         # Elsewhere the values continue smoothly and are not measured.\n\
         u_m,v_m,du_m,dv_m,covered\n"
    );
    for k in 0..points {
        for i in 0..points {
            let spot = [place(i), place(k)];
            let [du, dv] = calibration.correction(psd, spot);
            let covered = u8::from(near(|at| lattice.covers(at), spot));
            let _ = writeln!(text, "{:.10},{:.10},{du:.13},{dv:.13},{covered}", spot[0], spot[1]);
        }
    }
    text
}

/// A point on the edge of a cell belongs to the cells on both sides.
fn near(covers: impl Fn([f64; 2]) -> bool, [u, v]: [f64; 2]) -> bool {
    let rounding = 1e-9;
    [-rounding, rounding].iter().any(|du| [-rounding, rounding].iter().any(|dv| covers([u + du, v + dv])))
}
