//! Correction table for the non-linearity of a PSD.
//!
//! The points form a rectangular grid, in any order, that covers the whole sensitive area. Corrections
//! between the points are interpolated bilinearly.

/// A table may end this far before the edge, metres: rounding.
const SLACK: f64 = 1e-9;

/// Largest correction relative to half the side: twenty times what a lateral-effect PSD needs.
const LARGEST: f64 = 0.4;

/// A correction table.
#[derive(Clone, Debug, PartialEq)]
pub struct Correction {
    u: Vec<f64>,
    v: Vec<f64>,
    /// Corrections in metres; row by row, with `u` as the inner index.
    d: Vec<[f64; 2]>,
}

/// Reasons why points do not form a correction table.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CorrectionError {
    /// A number is not finite.
    #[error("row {row}: every value must be a finite number of metres")]
    NotFinite {
        /// Row of the table, counted from 1, without the header.
        row: usize,
    },
    /// The points do not form a grid.
    #[error("the points must form a full grid: {columns} x {rows} positions, but there are {points} points")]
    NoGrid {
        /// Number of different values of u.
        columns: usize,
        /// Number of different values of v.
        rows: usize,
        /// Number of rows in the file.
        points: usize,
    },
    /// A value out of range for the PSD: probably in another unit.
    #[error(
        "row {row}: the {what} {value} m is out of range for a PSD of +-{:.3} mm (limit +-{:.3} mm); use metres",
        half_size * 1e3, limit * 1e3
    )]
    Unit {
        /// Row of the table, counted from 1, without the header.
        row: usize,
        /// "position" or "correction".
        what: &'static str,
        /// The value, metres.
        value: f64,
        /// The limit, metres.
        limit: f64,
        /// Half the side of the area, metres.
        half_size: f64,
    },
    /// The grid does not cover the whole area.
    #[error("the grid must cover +-{:.3} mm in u and v", half_size * 1e3)]
    TooSmall {
        /// Half the side of the area, metres.
        half_size: f64,
    },
}

/// A point of a table: at the reading (u, v) the true spot is (u + du, v + dv). Metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectionPoint {
    /// Reading along u.
    pub u: f64,
    /// Reading along v.
    pub v: f64,
    /// Correction of `u`.
    pub du: f64,
    /// Correction of `v`.
    pub dv: f64,
}

impl Correction {
    /// The table of these points, for a PSD whose half edge length is `half_size` metres.
    ///
    /// # Errors
    /// The points do not form a full grid that covers the PSD, or a number is not finite or out of range.
    pub fn new(rows: &[CorrectionPoint], half_size: f64) -> Result<Self, CorrectionError> {
        let finite = |r: &CorrectionPoint| [r.u, r.v, r.du, r.dv].iter().all(|x| x.is_finite());
        if let Some(i) = rows.iter().position(|r| !finite(r)) {
            return Err(CorrectionError::NotFinite { row: i + 1 });
        }
        for (i, r) in rows.iter().enumerate() {
            let within = |what, values: [f64; 2], limit: f64| {
                let wrong = values.into_iter().find(|value| value.abs() > limit);
                wrong.map_or(Ok(()), |value| {
                    Err(CorrectionError::Unit { row: i + 1, what, value, limit, half_size })
                })
            };
            within("position", [r.u, r.v], 2.0 * half_size)?;
            within("correction", [r.du, r.dv], LARGEST * half_size)?;
        }
        let (u, v) = (places(rows.iter().map(|r| r.u)), places(rows.iter().map(|r| r.v)));
        let no_grid = CorrectionError::NoGrid { columns: u.len(), rows: v.len(), points: rows.len() };
        if u.len() < 2 || v.len() < 2 || rows.len() != u.len() * v.len() {
            return Err(no_grid);
        }
        let mut d = vec![[f64::NAN; 2]; rows.len()];
        for row in rows {
            let at = |places: &[f64], x: f64| places.partition_point(|p| *p < x);
            d[at(&v, row.v) * u.len() + at(&u, row.u)] = [row.du, row.dv];
        }
        if d.iter().any(|d| d[0].is_nan()) {
            return Err(no_grid); // one point is duplicated, so another one is missing
        }
        let edge = half_size - SLACK; // 6.5e-3 differs from 13e-3 / 2 by rounding
        let covers = |p: &[f64]| p[0] <= -edge && p[p.len() - 1] >= edge;
        if !(covers(&u) && covers(&v)) {
            return Err(CorrectionError::TooSmall { half_size });
        }
        Ok(Self { u, v, d })
    }

    /// The true spot for a reading, metres. A reading outside the grid gets the correction of the nearest
    /// edge.
    pub fn apply(&self, spot: [f64; 2]) -> [f64; 2] {
        let (i, a) = cell(&self.u, spot[0]);
        let (k, b) = cell(&self.v, spot[1]);
        let at = |i: usize, k: usize| self.d[k * self.u.len() + i];
        [0, 1].map(|x| {
            let low = at(i, k)[x] * (1.0 - a) + at(i + 1, k)[x] * a;
            let high = at(i, k + 1)[x] * (1.0 - a) + at(i + 1, k + 1)[x] * a;
            spot[x] + low * (1.0 - b) + high * b
        })
    }
}

/// The different values, in ascending order.
fn places(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut places: Vec<f64> = values.collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    places
}

/// The interval of the grid that contains `x`, and the position of `x` in it, 0 to 1.
fn cell(places: &[f64], x: f64) -> (usize, f64) {
    let i = places.partition_point(|p| *p <= x).clamp(1, places.len() - 1) - 1;
    (i, ((x - places[i]) / (places[i + 1] - places[i])).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(f: impl Fn(f64, f64) -> [f64; 2]) -> Vec<CorrectionPoint> {
        let places = [-7e-3, -2e-3, 0.0, 3e-3, 7e-3];
        let point = |u, v| CorrectionPoint { u, v, du: f(u, v)[0], dv: f(u, v)[1] };
        places.into_iter().flat_map(|u| places.map(|v| point(u, v))).collect()
    }

    #[test]
    fn a_bilinear_error_is_corrected_exactly() {
        let error = |u: f64, v: f64| [1e-3 * u + 2.0 * u * v, -3e-3 * v + 1e-5];
        let table = Correction::new(&grid(error), 6.5e-3).unwrap();
        for (u, v) in [(0.0, 0.0), (1.3e-3, -4.4e-3), (-6.5e-3, 6.5e-3), (3e-3, 3e-3), (7e-3, 7e-3)] {
            let [du, dv] = error(u, v);
            let [cu, cv] = table.apply([u, v]);
            assert!((cu - u - du).abs() < 1e-15 && (cv - v - dv).abs() < 1e-15, "{u} {v}");
        }
    }

    #[test]
    fn an_invalid_grid_is_refused() {
        let say = |rows: &[CorrectionPoint], half| Correction::new(rows, half).unwrap_err().to_string();
        let mut rows = grid(|_, _| [0.0; 2]);
        assert!(say(&rows, 8e-3).contains("8.000 mm"));
        rows[7].u = rows[8].u;
        rows[7].v = rows[8].v;
        assert!(say(&rows, 6e-3).contains("full grid: 5 x 5"));
        rows.pop();
        assert!(say(&rows, 6e-3).contains("24 points"));
        rows[3].dv = f64::NAN;
        assert!(say(&rows, 6e-3).contains("row 4"));
        rows[3].dv = 0.07;
        assert!(say(&rows, 6.5e-3).contains("row 4: the correction 0.07 m is out of range"));
        rows[0].u = -6.5;
        assert!(say(&rows, 6.5e-3).contains("row 1: the position -6.5 m is out of range"));
    }
}
