//! Correction table for the non-linearity of a PSD.
//!
//! The points form a rectangular grid, in any order, that covers the whole sensitive area. Corrections
//! between the points are interpolated bilinearly. A table states where measurements support it: a reading is
//! covered if all four points around it are.

/// A table may end this far before the edge, metres: rounding.
const SLACK: f64 = 1e-9;

/// Largest correction relative to half the side: twenty times what a lateral-effect PSD needs.
const LARGEST: f64 = 0.4;

/// A correction table.
#[derive(Clone, Debug, PartialEq)]
pub struct Correction {
    u: Axis,
    v: Axis,
    /// Corrections in metres; row by row, with `u` as the inner index.
    d: Vec<[f64; 2]>,
    /// The points that are not covered, in the order of `d`; `None`: all points are.
    uncovered: Option<Vec<bool>>,
}

/// The places of the grid along one axis.
#[derive(Clone, Debug, PartialEq)]
struct Axis {
    /// In ascending order; at least two.
    places: Vec<f64>,
    /// Intervals per metre, on average: finds the interval at once if the places are evenly spaced.
    per_metre: f64,
}

/// A spot after its correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected {
    /// The true spot, metres.
    pub spot: [f64; 2],
    /// Whether measurements support the correction.
    pub covered: bool,
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
    /// Whether measurements support this point.
    pub covered: bool,
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
        let mut uncovered = vec![false; rows.len()];
        for row in rows {
            let at = |places: &[f64], x: f64| places.partition_point(|p| *p < x);
            let point = at(&v, row.v) * u.len() + at(&u, row.u);
            (d[point], uncovered[point]) = ([row.du, row.dv], !row.covered);
        }
        if d.iter().any(|d| d[0].is_nan()) {
            return Err(no_grid); // one point is duplicated, so another one is missing
        }
        let edge = half_size - SLACK; // 6.5e-3 differs from 13e-3 / 2 by rounding
        let covers = |p: &[f64]| p[0] <= -edge && p[p.len() - 1] >= edge;
        if !(covers(&u) && covers(&v)) {
            return Err(CorrectionError::TooSmall { half_size });
        }
        let uncovered = uncovered.contains(&true).then_some(uncovered);
        Ok(Self { u: Axis::new(u), v: Axis::new(v), d, uncovered })
    }

    /// The true spot for a reading, and whether measurements support it. A reading outside the grid gets the
    /// correction of the nearest edge, and is not covered.
    pub fn apply(&self, reading: [f64; 2]) -> Corrected {
        let (i, a) = self.u.cell(reading[0]);
        let (k, b) = self.v.cell(reading[1]);
        let row = self.u.places.len();
        let low = k * row + i;
        let high = low + row;
        let spot = [0, 1].map(|x| {
            let low = self.d[low][x] * (1.0 - a) + self.d[low + 1][x] * a;
            let high = self.d[high][x] * (1.0 - a) + self.d[high + 1][x] * a;
            reading[x] + low * (1.0 - b) + high * b
        });
        let measured = |uncovered: &Vec<bool>| ![low, low + 1, high, high + 1].iter().any(|i| uncovered[*i]);
        let within = self.u.contains(reading[0]) && self.v.contains(reading[1]);
        Corrected { spot, covered: within && self.uncovered.as_ref().is_none_or(measured) }
    }

    /// The numbers of the table, in an order that does not depend on its file: the places along u and v, then du,
    /// dv and 1 or 0 (covered or not) of each point.
    pub fn numbers(&self) -> impl Iterator<Item = f64> {
        let covered = |i: usize| self.uncovered.as_ref().is_none_or(|uncovered| !uncovered[i]);
        let points = self.d.iter().enumerate().flat_map(move |(i, d)| [d[0], d[1], f64::from(covered(i))]);
        self.u.places.iter().chain(&self.v.places).copied().chain(points)
    }

    /// The part of the grid's points that measurements support, 0 to 1.
    pub fn covered(&self) -> f64 {
        let uncovered = self.uncovered.iter().flatten().filter(|uncovered| **uncovered).count();
        1.0 - uncovered as f64 / self.d.len() as f64
    }
}

/// The different values, in ascending order.
fn places(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut places: Vec<f64> = values.collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    places
}

impl Axis {
    fn new(places: Vec<f64>) -> Self {
        let per_metre = (places.len() - 1) as f64 / (places[places.len() - 1] - places[0]);
        Self { places, per_metre }
    }

    fn contains(&self, x: f64) -> bool {
        (self.places[0] - SLACK..=self.places[self.places.len() - 1] + SLACK).contains(&x)
    }

    /// The interval of the grid that contains `x`, and the position of `x` in it, 0 to 1.
    fn cell(&self, x: f64) -> (usize, f64) {
        let i = self.interval(x);
        let (low, high) = (self.places[i], self.places[i + 1]);
        (i, ((x - low) / (high - low)).clamp(0.0, 1.0))
    }

    /// The interval that contains `x`, or the nearest one. If the places are evenly spaced, the first guess is right,
    /// or wrong by one because of rounding.
    fn interval(&self, x: f64) -> usize {
        let last = self.places.len() - 2;
        let guess = (((x - self.places[0]) * self.per_metre) as usize).min(last); // negative and NaN: 0
        let contains = |i: usize| (i == 0 || self.places[i] <= x) && (i == last || x < self.places[i + 1]);
        if contains(guess) {
            return guess;
        }
        let neighbours = [guess.saturating_sub(1), (guess + 1).min(last)];
        let near = neighbours.into_iter().find(|i| contains(*i));
        near.unwrap_or_else(|| self.places.partition_point(|place| *place <= x).clamp(1, last + 1) - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(f: impl Fn(f64, f64) -> [f64; 2]) -> Vec<CorrectionPoint> {
        let places = [-7e-3, -2e-3, 0.0, 3e-3, 7e-3];
        let point = |u, v| CorrectionPoint { u, v, du: f(u, v)[0], dv: f(u, v)[1], covered: true };
        places.into_iter().flat_map(|u| places.map(|v| point(u, v))).collect()
    }

    #[test]
    fn a_bilinear_error_is_corrected_exactly() {
        let error = |u: f64, v: f64| [1e-3 * u + 2.0 * u * v, -3e-3 * v + 1e-5];
        let table = Correction::new(&grid(error), 6.5e-3).unwrap();
        for (u, v) in [(0.0, 0.0), (1.3e-3, -4.4e-3), (-6.5e-3, 6.5e-3), (3e-3, 3e-3), (7e-3, 7e-3)] {
            let [du, dv] = error(u, v);
            let Corrected { spot: [cu, cv], covered } = table.apply([u, v]);
            assert!((cu - u - du).abs() < 1e-15 && (cv - v - dv).abs() < 1e-15, "{u} {v}");
            assert!(covered, "{u} {v}");
        }
    }

    #[test]
    fn a_reading_is_covered_if_all_points_around_it_are_and_none_is_outside_the_grid() {
        let mut rows = grid(|_, _| [1e-6, 2e-6]);
        let corner = rows.iter().position(|row| (row.u, row.v) == (3e-3, 3e-3)).unwrap();
        rows[corner].covered = false;
        let table = Correction::new(&rows, 6.5e-3).unwrap();
        assert_eq!(table.covered(), 24.0 / 25.0);
        for (u, v, covered) in [
            (-1e-3, -1e-3, true),
            (1e-3, 1e-3, false),
            (5e-3, 5e-3, false),
            (2.999e-3, -1e-3, true),
            (-5e-3, 6e-3, true),
            (7.1e-3, -6e-3, false),
            (-6e-3, -7.1e-3, false),
        ] {
            let corrected = table.apply([u, v]);
            assert_eq!(corrected.covered, covered, "{u} {v}");
            // The correction itself is that of the table, covered or not.
            assert!((corrected.spot[0] - u - 1e-6).abs() < 1e-15, "{u} {v}");
        }
        assert!(!table.apply([f64::NAN, 0.0]).covered);
    }

    #[test]
    fn the_interval_is_that_of_a_search_on_even_and_uneven_grids() {
        let even = (0..=130).map(|i| f64::from(i) * 1e-4 - 6.5e-3).collect();
        let halves = (0..=50).map(|i| f64::from(i * i) * 5e-6 - 6.5e-3).collect();
        for places in [even, halves, vec![-6.5e-3, 6.5e-3], vec![-6.5e-3, -6.49e-3, 6.5e-3]] {
            let axis = Axis::new(places.clone());
            let ends = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
            let between = (-7000..7000).map(|i| f64::from(i) * 1.000_3e-6);
            let near = places.iter().flat_map(|p| [*p, p.next_up(), p.next_down()]);
            for x in between.chain(near).chain(ends) {
                let searched = places.partition_point(|p| *p <= x).clamp(1, places.len() - 1) - 1;
                assert_eq!(axis.interval(x), searched, "{x} {places:?}");
            }
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
