//! The error of a PSD as a smooth function of its reading: polynomials of low degree, and a cubic spline on a
//! square lattice of knots for what they leave.
//!
//! The spline has a prior: a random field whose values at two places correlate over a certain length. Only the
//! coefficients that some reading touches are unknowns.

use serde::{Deserialize, Serialize};

use super::Matrix;

/// Number of polynomials for one coordinate of one PSD: Legendre products of degree 1 to 7.
pub const POLYNOMIALS: usize = 35;
/// Highest degree.
const DEGREE: usize = 7;
/// Correlation of a coefficient with itself beyond the field: keeps the matrix positive definite.
const NUGGET: f64 = 1e-3;

/// A cell without a reading is covered if at least this number of its eight neighbours have one.
const AROUND: usize = 5;

/// Largest number of knots from the centre of a PSD to its edge.
const MOST_KNOTS: f64 = 200.0;
/// Cells beyond this one, in units of the knots, count as this one: no lattice is as wide.
const FARTHEST: f64 = 1e6;

/// The prior of the spline.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Field {
    /// Distance of the knots, metres.
    pub knots: f64,
    /// Rms of the field, metres.
    pub rms: f64,
    /// Length over which it correlates (of a Gaussian correlation), metres.
    pub length: f64,
}

/// Degrees along u and v of the polynomials, in their order.
pub fn degrees() -> impl Iterator<Item = (usize, usize)> {
    (1..=DEGREE).flat_map(|sum| (0..=sum).map(move |j| (sum - j, j)))
}

/// The polynomials at a reading, for a PSD whose half edge length is `half_size`.
pub fn polynomials(spot: [f64; 2], half_size: f64) -> [f64; POLYNOMIALS] {
    let [u, v] = spot.map(|x| legendre(x / half_size));
    let mut values = [0.0; POLYNOMIALS];
    for (value, (i, j)) in values.iter_mut().zip(degrees()) {
        *value = u[i] * v[j];
    }
    values
}

fn legendre(x: f64) -> [f64; DEGREE + 1] {
    let mut p = [1.0; DEGREE + 1];
    p[1] = x;
    for n in 1..DEGREE {
        let k = n as f64;
        p[n + 1] = ((2.0 * k + 1.0) * x * p[n] - k * p[n - 1]) / (k + 1.0);
    }
    p
}

/// The lattice of spline coefficients of one PSD, and which of them are unknowns.
#[derive(Clone, Debug, PartialEq)]
pub struct Lattice {
    knots: f64,
    /// Nodes run from `-reach` to `reach` along u and v.
    reach: i32,
    /// Place of each node among the unknowns, row by row.
    places: Vec<Option<u32>>,
    /// The nodes that are unknowns, in the order of their places.
    nodes: Vec<[i32; 2]>,
    /// Cells with a reading: lower corner.
    cells: Vec<[i32; 2]>,
}

impl Lattice {
    /// The lattice with these readings.
    pub fn new(knots: f64, half_size: f64, spots: impl Iterator<Item = [f64; 2]>) -> Self {
        let mut cells: Vec<_> = spots.map(|spot| spot.map(|x| cell(x / knots))).collect();
        cells.sort_unstable();
        cells.dedup();
        Self::of_cells(knots, half_size, cells)
    }

    /// Whether numbers from a file describe a lattice: knots closer than 1 um, or more than 200 from the centre of the
    /// PSD to its edge, do not.
    pub fn is_usable(knots: f64, half_size: f64) -> bool {
        knots > 1e-6 && half_size > 0.0 && half_size < MOST_KNOTS * knots
    }

    /// The lattice with readings in these cells. Lengths from a file: see [`Lattice::is_usable`].
    pub fn of_cells(knots: f64, half_size: f64, cells: Vec<[i32; 2]>) -> Self {
        // A reading slightly beyond the edge belongs to a cell further out.
        let reach = (half_size / knots).ceil() as i32 + 3;
        let mut nodes: Vec<[i32; 2]> = Vec::new();
        for [i, j] in &cells {
            nodes.extend((-1..3).flat_map(|a| (-1..3).map(move |b| [i + a, j + b])));
        }
        nodes.retain(|node| node.iter().all(|x| x.abs() <= reach));
        nodes.sort_unstable();
        nodes.dedup();
        let side = (2 * reach + 1) as usize;
        let mut lattice = Self { knots, reach, places: vec![None; side * side], nodes, cells };
        for (place, node) in lattice.nodes.iter().enumerate() {
            lattice.places[index(reach, *node)] = Some(place as u32);
        }
        lattice
    }

    /// Number of unknowns for each of u and v.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether no reading touches the lattice.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The cells with a reading: lower corners in units of the knots.
    pub fn cells(&self) -> &[[i32; 2]] {
        &self.cells
    }

    /// The nodes with unknowns, in units of the knots, in the order of their places.
    pub(super) fn nodes(&self) -> &[[i32; 2]] {
        &self.nodes
    }

    /// Distance of the knots, metres.
    pub fn knots(&self) -> f64 {
        self.knots
    }

    /// Whether a reading lies among those of the calibration: its cell has one, or most cells around it do.
    pub fn covers(&self, spot: [f64; 2]) -> bool {
        let [i, j] = spot.map(|x| cell(x / self.knots));
        let has = |cell| self.cells.binary_search(&cell).is_ok();
        let around = || {
            let cells = (-1..=1).flat_map(|a| (-1..=1).map(move |b| [i + a, j + b]));
            cells.filter(|cell| has(*cell)).count()
        };
        has([i, j]) || around() >= AROUND
    }

    /// The splines at a reading that are unknowns: place and value, by ascending place.
    pub fn splines(&self, spot: [f64; 2]) -> impl Iterator<Item = (usize, f64)> {
        let [(i, u), (j, v)] = spot.map(|x| {
            let x = x / self.knots;
            (cell(x), cubic(x - x.floor()))
        });
        (0..4).flat_map(move |a| (0..4).map(move |b| (a, b))).filter_map(move |(a, b)| {
            let node = [i - 1 + a as i32, j - 1 + b as i32];
            if node.iter().any(|x| x.abs() > self.reach) {
                return None;
            }
            self.places[index(self.reach, node)].map(|place| (place as usize, u[a] * v[b]))
        })
    }

    /// Prior covariance of the coefficients of one coordinate.
    pub(super) fn covariance(&self, field: &Field) -> Matrix {
        let ratio = self.knots / field.length;
        let variance = (field.rms / unit_rms(ratio)).powi(2);
        let n = self.len();
        Matrix::from_fn(n, n, |i, j| {
            let [a, b] = [self.nodes[i], self.nodes[j]];
            variance * correlation(a, b, ratio)
        })
    }
}

/// The cell of a place in units of the knots, along one coordinate.
fn cell(place: f64) -> i32 {
    place.floor().clamp(-FARTHEST, FARTHEST) as i32
}

fn index(reach: i32, [i, j]: [i32; 2]) -> usize {
    ((i + reach) * (2 * reach + 1) + j + reach) as usize
}

fn correlation(a: [i32; 2], b: [i32; 2], ratio: f64) -> f64 {
    let [du, dv] = [0, 1].map(|k| f64::from(a[k] - b[k]) * ratio);
    let own = if a == b { NUGGET } else { 0.0 };
    (-0.5 * (du * du + dv * dv)).exp() + own
}

/// The four uniform cubic splines at a place 0 to 1 of a cell.
fn cubic(x: f64) -> [f64; 4] {
    let y = 1.0 - x;
    let inner = |t: f64| (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0;
    [y * y * y / 6.0, inner(x), inner(y), x * x * x / 6.0]
}

/// Rms over a cell of a field whose coefficients have unit variance.
fn unit_rms(ratio: f64) -> f64 {
    const PLACES: usize = 8;
    let weights = (0..PLACES).map(|k| cubic((k as f64 + 0.5) / PLACES as f64)).collect::<Vec<_>>();
    // Without the nugget the two directions separate; the nugget adds the squared weights.
    let along = |own: bool| {
        let sum = |w: &[f64; 4]| -> f64 {
            let terms = (0..4).flat_map(|a| (0..4).map(move |b| (a, b)));
            terms
                .map(|(a, b)| {
                    let d = (a as f64 - b as f64) * ratio;
                    let r = if own { f64::from(u8::from(a == b)) } else { (-0.5 * d * d).exp() };
                    w[a] * w[b] * r
                })
                .sum()
        };
        weights.iter().map(sum).sum::<f64>() / PLACES as f64
    };
    (along(false).powi(2) + NUGGET * along(true).powi(2)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thirty_five_polynomials_of_degree_one_to_seven() {
        assert_eq!(degrees().count(), POLYNOMIALS);
        assert_eq!(degrees().next(), Some((1, 0)));
        let values = polynomials([6.5e-3, -6.5e-3], 6.5e-3);
        for (value, (_, j)) in values.iter().zip(degrees()) {
            assert!((value - if j % 2 == 0 { 1.0 } else { -1.0 }).abs() < 1e-14);
        }
        let half = polynomials([3.25e-3, 0.0], 6.5e-3);
        assert!((half[0] - 0.5).abs() < 1e-15 && (half[2] - -0.125).abs() < 1e-15);
    }

    #[test]
    fn splines_sum_up_to_one_where_all_are_unknowns_and_continue_smoothly() {
        let lattice = Lattice::new(0.5e-3, 6.5e-3, [[1.2e-3, -3.3e-3]].into_iter());
        assert_eq!(lattice.len(), 16);
        let sum = |spot| lattice.splines(spot).map(|(_, value)| value).sum::<f64>();
        assert!((sum([1.1e-3, -3.4e-3]) - 1.0).abs() < 1e-14);
        assert_eq!(sum([4e-3, 4e-3]), 0.0);
        assert!(lattice.covers([1.49e-3, -3.01e-3]) && !lattice.covers([1.51e-3, -3.01e-3]));
        let at = |u| lattice.splines([u, -3.3e-3]).find(|(place, _)| *place == 5).map_or(0.0, |s| s.1);
        for knot in [0.5e-3, 1.0e-3, 1.5e-3] {
            assert!((at(knot - 1e-9) - at(knot + 1e-9)).abs() < 1e-5);
        }
    }

    #[test]
    fn a_reading_far_from_the_psd_has_no_spline_and_is_not_covered() {
        let lattice = Lattice::new(0.5e-3, 6.5e-3, [[1.2e-3, -3.3e-3]].into_iter());
        for far in [1e30, -1e30, f64::INFINITY, f64::MIN] {
            assert_eq!(lattice.splines([far, -3.3e-3]).count(), 0);
            assert!(!lattice.covers([1.2e-3, far]));
        }
        assert!(Lattice::is_usable(0.65e-3, 6.5e-3));
        for (knots, half_size) in [(1e-7, 1e-6), (1e-5, 6.5e-3), (0.65e-3, 0.0), (f64::NAN, 6.5e-3)] {
            assert!(!Lattice::is_usable(knots, half_size), "{knots} {half_size}");
        }
    }

    #[test]
    fn the_prior_of_the_coefficients_gives_a_field_of_the_wanted_rms() {
        let spots = (0..40).map(|i| [f64::from(i % 7) * 0.4e-3 - 1e-3, f64::from(i / 7) * 0.4e-3]);
        let lattice = Lattice::new(0.65e-3, 6.5e-3, spots);
        let field = Field { knots: 0.65e-3, rms: 2e-6, length: 0.5e-3 };
        let covariance = lattice.covariance(&field);
        let n = 16;
        let (mut sum, inner) = (0.0, 0.65e-3);
        for a in 0..n {
            for b in 0..n {
                let place = |k: i32| inner * (f64::from(k) + 0.5) / f64::from(n);
                let terms: Vec<_> = lattice.splines([place(a), place(b)]).collect();
                for (i, x) in &terms {
                    for (j, y) in &terms {
                        sum += x * y * covariance[(*i, *j)];
                    }
                }
            }
        }
        assert!((sum / f64::from(n * n)).sqrt() / 2e-6 - 1.0 < 1e-3);
    }
}
