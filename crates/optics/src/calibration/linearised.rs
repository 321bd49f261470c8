//! One point, solved and linearised in all parameters.

use nalgebra::SMatrix;

use super::instrument::{Eight, Instrument, Nine, State};
use super::map::{Lattice, POLYNOMIALS, polynomials};
use super::parameters::{GEOMETRY, Nominal, step};
use super::point::Point;
use super::{Matrix, Vector};

/// Where each parameter is in the vector of all: geometry, zeros of the runs, polynomials, splines.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Number of runs with a zero of their own.
    pub runs: usize,
    /// The splines of PSDs A, B, C.
    pub lattices: [Lattice; 3],
    /// Half the side of each PSD, metres.
    pub half_sizes: [f64; 3],
}

/// The six zeros of a run.
const ZERO: usize = 6;

impl Layout {
    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.splines(3, 0)
    }

    /// First zero of a run.
    pub fn zero(run: usize) -> usize {
        GEOMETRY + ZERO * run
    }

    /// First polynomial of a coordinate (0: u, 1: v) of a PSD.
    pub fn polynomials(&self, psd: usize, coordinate: usize) -> usize {
        Self::zero(self.runs) + POLYNOMIALS * (2 * psd + coordinate)
    }

    /// First spline of a coordinate of a PSD.
    pub fn splines(&self, psd: usize, coordinate: usize) -> usize {
        let before: usize = self.lattices[..psd].iter().map(|lattice| 2 * lattice.len()).sum();
        let own = if coordinate == 0 { 0 } else { self.lattices[psd].len() };
        self.polynomials(3, 0) + before + own
    }

    /// The functions of the error of the PSDs at these readings.
    pub(super) fn basis(&self, spots: &[f64; 6], run: Option<usize>) -> Basis {
        let spot = |i: usize| [spots[2 * i], spots[2 * i + 1]];
        let splines = [0, 1, 2].map(|i| self.lattices[i].splines(spot(i)).collect());
        let mut basis = Basis {
            polynomials: [0, 1, 2].map(|i| polynomials(spot(i), self.half_sizes[i])),
            splines,
            columns: (0..GEOMETRY).collect(),
            run,
        };
        basis.columns.extend(run.into_iter().flat_map(|run| Self::zero(run)..Self::zero(run + 1)));
        basis.columns.extend(self.polynomials(0, 0)..self.polynomials(3, 0));
        for (psd, coordinate) in coordinates() {
            let from = self.splines(psd, coordinate);
            basis.columns.extend(basis.splines[psd].iter().map(|(place, _)| from + place));
        }
        basis
    }

    /// The spots for these readings.
    pub(super) fn corrected(&self, theta: &[f64], basis: &Basis, readings: &[f64; 6]) -> [f64; 6] {
        let mut spots = *readings;
        for (psd, coordinate) in coordinates() {
            let at = self.polynomials(psd, coordinate);
            let smooth: f64 = basis.polynomials[psd].iter().zip(&theta[at..]).map(|(b, c)| b * c).sum();
            let from = self.splines(psd, coordinate);
            let fine: f64 = basis.splines[psd].iter().map(|(place, b)| b * theta[from + place]).sum();
            spots[2 * psd + coordinate] += smooth + fine;
        }
        spots
    }
}

/// PSD and coordinate, in the order of the spots.
pub(super) fn coordinates() -> impl Iterator<Item = (usize, usize)> {
    (0..3).flat_map(|psd| [(psd, 0), (psd, 1)])
}

/// The functions of the error of the PSDs at the readings of a point.
#[derive(Clone, Debug)]
pub(super) struct Basis {
    polynomials: [[f64; POLYNOMIALS]; 3],
    splines: [Vec<(usize, f64)>; 3],
    /// The parameters on which the point depends, ascending.
    pub columns: Vec<usize>,
    run: Option<usize>,
}

/// An instrument, and those with each geometric parameter a little changed.
pub(super) struct Neighbours {
    pub centre: Instrument,
    pairs: Vec<[Instrument; 2]>,
}

impl Neighbours {
    pub fn new(nominal: &Nominal, theta: &[f64]) -> Self {
        let geometry = &theta[..GEOMETRY];
        let changed = |i: usize, by: f64| {
            let mut theta = geometry.to_vec();
            theta[i] += by;
            nominal.instrument(&theta)
        };
        let pairs = (0..GEOMETRY).map(|i| [changed(i, step(i)), changed(i, -step(i))]).collect();
        Self { centre: nominal.instrument(geometry), pairs }
    }
}

/// A solved point and its derivatives.
pub(super) struct Response {
    pub state: State,
    /// Pose in the frame of the reference, and beam at the steering: computed minus measured.
    pub errors: Eight,
    /// Their derivatives with respect to the nine signals.
    pub by_signals: SMatrix<f64, 8, 9>,
    /// Their derivatives with respect to the parameters of [`Basis::columns`].
    pub jacobian: Matrix,
}

/// The spots and the logarithms of the powers as signals; `None` if a power is not positive.
pub(super) fn signals(spots: &[f64; 6], powers: &[f64; 3]) -> Option<Nine> {
    let mut signals = Nine::zeros();
    signals.fixed_rows_mut::<6>(0).copy_from_slice(spots);
    for (i, power) in powers.iter().enumerate() {
        signals[6 + i] = power.ln();
    }
    signals.iter().all(|x| x.is_finite()).then_some(signals)
}

impl Response {
    /// Solves a point; `None` if it has no solution.
    pub fn new(
        layout: &Layout,
        instruments: &Neighbours,
        theta: &[f64],
        (point, basis): (&Point, &Basis),
        start: Option<&State>,
    ) -> Option<Self> {
        let centre = &instruments.centre;
        let target = signals(&layout.corrected(theta, basis, &point.spots), &point.powers)?;
        let state = centre.solve(&target, start)?;
        let by_state = centre.error_slopes(&state, point);
        let inverse = centre.slopes(&state)?.try_inverse()?;
        let by_signals = by_state * inverse;
        let mut errors = centre.errors(&state, point);
        let mut jacobian = Matrix::zeros(8, basis.columns.len());
        for (i, [plus, minus]) in instruments.pairs.iter().enumerate() {
            let direct = plus.errors(&state, point) - minus.errors(&state, point);
            let signals = plus.signals(&state)? - minus.signals(&state)?;
            jacobian.set_column(i, &((direct - by_signals * signals) / (2.0 * step(i))));
        }
        let mut at = GEOMETRY;
        if let Some(run) = basis.run {
            for i in 0..ZERO {
                errors[i] -= theta[Layout::zero(run) + i];
                jacobian[(i, at + i)] = -1.0;
            }
            at += ZERO;
        }
        for (psd, coordinate) in coordinates() {
            let slope = by_signals.column(2 * psd + coordinate);
            for value in &basis.polynomials[psd] {
                jacobian.set_column(at, &(slope * *value));
                at += 1;
            }
        }
        for (psd, coordinate) in coordinates() {
            let slope = by_signals.column(2 * psd + coordinate);
            for (_, value) in &basis.splines[psd] {
                jacobian.set_column(at, &(slope * *value));
                at += 1;
            }
        }
        Some(Self { state, errors, by_signals, jacobian })
    }

    /// The errors that are measured, divided by the root of their covariance.
    pub fn whitened(&self, centre: &Instrument, point: &Point) -> Option<Rows> {
        let covariance = self.covariance(centre, point);
        let mut measured: Vec<usize> = (0..6).filter(|i| point.reference[*i].is_some()).collect();
        measured.extend(point.steering.iter().flat_map(|_| [6, 7]));
        let d = measured.len();
        let own = Matrix::from_fn(d, d, |i, j| covariance[(measured[i], measured[j])]);
        let root = nalgebra::Cholesky::new(own)?.unpack();
        let mut errors = Vector::from_fn(d, |i, _| self.errors[measured[i]]);
        let mut jacobian = self.jacobian.select_rows(&measured);
        root.solve_lower_triangular_mut(&mut errors);
        root.solve_lower_triangular_mut(&mut jacobian);
        Some(Rows { errors, jacobian })
    }

    /// Covariance of the errors by the noise of the point.
    pub fn covariance(&self, centre: &Instrument, point: &Point) -> SMatrix<f64, 8, 8> {
        noise_of_errors(&self.by_signals, centre, point)
    }
}

/// Covariance of the errors of a point by its noise, with their derivatives with respect to the nine signals.
pub(super) fn noise_of_errors(
    by_signals: &SMatrix<f64, 8, 9>,
    centre: &Instrument,
    point: &Point,
) -> SMatrix<f64, 8, 8> {
    let mut noise = Nine::zeros();
    for (i, deviation) in point.spot_deviations.iter().enumerate() {
        noise[i] = deviation.powi(2);
    }
    for i in 0..3 {
        noise[6 + i] = (point.power_deviations[i] / point.powers[i]).powi(2);
    }
    let mut covariance = by_signals * SMatrix::from_diagonal(&noise) * by_signals.transpose();
    for (i, known) in point.reference.iter().enumerate() {
        covariance[(i, i)] += known.map_or(0.0, |known| known.deviation.powi(2));
    }
    let mut steering = covariance.fixed_view_mut::<2, 2>(6, 6);
    steering += centre.readback_covariance(point);
    covariance
}

/// The measured errors of a point and their derivatives, in units of their deviation and uncorrelated.
#[derive(Clone, Debug)]
pub(super) struct Rows {
    pub errors: Vector,
    pub jacobian: Matrix,
}

impl Rows {
    pub fn chi2(&self) -> f64 {
        self.errors.norm_squared()
    }
}
