//! The steps of a fit: the points, their solutions and the normal equations.

use nalgebra::{Matrix6, Vector6};

use super::cholesky::Factor;
use super::climb::Climb;
use super::fit::{
    Dropped, FIRST_FIELD, FitError, Fitted, IMPROBABLE, Job, Likelihoods, Progress, Stage, USUAL_FIELD, tail,
};
use super::held_out::HeldOut;
use super::instrument::State;
use super::linearised::{Basis, Layout, Neighbours, Response, Rows, signals};
use super::map::{Field, Lattice};
use super::normal::{Normal, Prior};
use super::parameters::GEOMETRY;
use super::point::Point;
use super::pointing::Pointing;
use super::result::Calibration;
use super::{Matrix, Vector};

/// The steps end when the cost changes by less,
const SETTLED: f64 = 0.01;
/// or, of those that only find gross errors, by this part of the cost.
const ROUGHLY_SETTLED: f64 = 1e-4;
/// A step may raise the cost by this part of it: the weights of the rows change with the parameters, so that the
/// steps do not end exactly at the smallest cost.
const TOLERATED: f64 = 1e-3;
/// Largest number of steps.
const MAX_STEPS: usize = 40;

/// The state of a fit.
pub(super) struct Session<'a> {
    pub job: Job<'a>,
    pub layout: Layout,
    pub bases: Vec<Basis>,
    /// Solutions of the points, from which the next ones start; `None`: the point is not used.
    pub states: Vec<Option<State>>,
    pub normal: Normal,
    prior: Option<Prior>,
    field: Field,
}

/// Errors of all points at some parameters.
#[derive(Clone, Debug, Default)]
pub(super) struct Assessment {
    /// Chi-square and number of rows of each point that is used.
    chi2: Vec<Option<(f64, usize)>>,
    /// Residual of the steering of each point that is used, metres.
    steering: Vec<Option<[f64; 2]>>,
    /// Sum of the data's share of the cost.
    data: f64,
}

impl Assessment {
    /// The residual of the steering, if it is larger than stated.
    pub fn pointing(&self, job: &Job<'_>) -> Option<Pointing> {
        Pointing::judge(job.points, &self.steering)
    }

    fn rows(&self) -> usize {
        self.chi2.iter().flatten().map(|(_, rows)| rows).sum()
    }
}

impl<'a> Session<'a> {
    pub fn new(job: Job<'a>, knots: f64) -> Result<Self, FitError> {
        let centred = job.nominal.instrument(&[0.0; GEOMETRY]);
        let solve = |p: &Point| signals(&p.spots, &p.powers).and_then(|s| centred.solve(&s, None));
        let states: Vec<_> = job.points.iter().map(solve).collect();
        if states.iter().all(Option::is_none) {
            return Err(FitError::NoPoints(states.len()));
        }
        let layout = layout(&job, &states, knots);
        let (bases, normal) = (bases(&job, &layout), Normal::new(layout.parameters()));
        let field = Field { knots, ..FIRST_FIELD };
        Ok(Self { job, layout, bases, states, normal, prior: None, field })
    }

    pub fn set_field(&mut self, field: &Field) -> Result<(), FitError> {
        self.field = *field;
        self.prior = Some(Prior::new(&self.layout, self.job.tolerances, field).ok_or(FitError::Singular)?);
        Ok(())
    }

    pub fn prior(&self) -> Result<&Prior, FitError> {
        self.prior.as_ref().ok_or(FitError::Singular)
    }

    /// Linearises all points at these parameters and sums up the normal equations. `None` if a point has no
    /// solution there.
    pub fn assess(&mut self, theta: &Vector, robust: bool) -> Option<Assessment> {
        let instruments = Neighbours::new(self.job.nominal, theta.as_slice());
        self.normal.clear();
        let mut sums = Assessment::default();
        for (k, point) in self.job.points.iter().enumerate() {
            let Some(start) = self.states[k] else {
                sums.chi2.push(None);
                sums.steering.push(None);
                continue;
            };
            let (response, rows) = self.linearise(&instruments, theta, k, &start)?;
            self.states[k] = Some(response.state);
            let (chi2, d) = (rows.chi2(), rows.errors.len());
            let own = 4.0 + d as f64;
            let weight = if robust { own / (4.0 + chi2) } else { 1.0 };
            self.normal.add(&rows, &self.bases[k].columns, weight);
            sums.data += if robust { own * (0.25 * chi2).ln_1p() } else { chi2 };
            sums.chi2.push(Some((chi2, d)));
            sums.steering.push(point.steering.map(|_| [response.errors[6], response.errors[7]]));
        }
        Some(sums)
    }

    /// A point, solved from `start` and linearised, and its rows.
    pub fn linearise(
        &self,
        instruments: &Neighbours,
        theta: &Vector,
        k: usize,
        start: &State,
    ) -> Option<(Response, Rows)> {
        let point = &self.job.points[k];
        let seen = (point, &self.bases[k]);
        let response = Response::new(&self.layout, instruments, theta.as_slice(), seen, Some(start))?;
        let rows = response.whitened(&instruments.centre, point)?;
        Some((response, rows))
    }

    /// Moves the zeros of the runs to where the errors of each run are smallest. A long step along a curved path
    /// would displace whole runs by more than their noise.
    fn centre_zeros(&mut self, theta: &mut Vector) {
        if self.layout.runs == 0 {
            return;
        }
        let instruments = Neighbours::new(self.job.nominal, theta.as_slice());
        let mut sums = vec![(Matrix6::<f64>::zeros(), Vector6::<f64>::zeros()); self.layout.runs];
        for (k, point) in self.job.points.iter().enumerate() {
            let (Some(run), Some(start)) = (point.run, &self.states[k]) else { continue };
            if !point.reference.iter().all(Option::is_some) {
                continue;
            }
            let Some((response, _)) = self.linearise(&instruments, theta, k, start) else { continue };
            let covariance =
                response.covariance(&instruments.centre, point).fixed_view::<6, 6>(0, 0).into_owned();
            let Some(weight) = covariance.try_inverse() else { continue };
            sums[run].0 += weight;
            sums[run].1 += weight * response.errors.fixed_rows::<6>(0);
        }
        for (run, (weight, errors)) in sums.into_iter().enumerate() {
            if let Some(mean) = weight.try_inverse().map(|inverse| inverse * errors) {
                let mut zero = theta.fixed_rows_mut::<6>(Layout::zero(run));
                zero += mean;
            }
        }
    }

    /// Gauss-Newton steps until the cost stands. Where a step raises the cost, it is damped.
    pub fn steps(
        &mut self,
        theta: &mut Vector,
        stage: Stage,
        progress: &mut impl FnMut(Progress),
    ) -> Result<Assessment, FitError> {
        let robust = stage == Stage::Robust;
        let cost = |session: &Self, theta: &Vector, sums: &Assessment| {
            Ok(sums.data + theta.dot(&session.prior()?.times(theta)))
        };
        let sums = self.assess(theta, robust).ok_or(FitError::Singular)?;
        let mut before = cost(self, theta, &sums)?;
        let mut pointing = sums.pointing(&self.job);
        let mut damping = 0.0;
        for step in 1..=MAX_STEPS {
            let mut candidate = &*theta + self.step(theta, damping)?;
            self.centre_zeros(&mut candidate);
            let next = self.assess(&candidate, robust);
            let after = next.as_ref().map_or(Ok(f64::INFINITY), |next| cost(self, &candidate, next))?;
            if after.is_nan() || after > before * (1.0 + TOLERATED) + SETTLED {
                damping = if damping == 0.0 { 1.0 } else { damping * 4.0 };
                // The normal equations of the place from which the next step starts.
                self.assess(theta, robust).ok_or(FitError::Singular)?;
                continue;
            }
            *theta = candidate;
            damping *= 0.7;
            let sums = next.unwrap_or_default();
            pointing = sums.pointing(&self.job);
            progress(Progress::Step { stage, step, cost: after / sums.rows() as f64 });
            let enough = if robust { SETTLED.max(ROUGHLY_SETTLED * before) } else { SETTLED };
            let settled = (before - after).abs() < enough;
            before = after;
            if settled || stage == Stage::First && step >= 2 {
                return Ok(sums);
            }
        }
        Err(FitError::NotConverged { steps: MAX_STEPS, pointing })
    }

    fn step(&self, theta: &Vector, damping: f64) -> Result<Vector, FitError> {
        let prior = self.prior()?;
        let mut matrix = self.normal.matrix.clone();
        // The steps are too long where hardly any data determine them: there the priors damp them.
        prior.add_to(&mut matrix, 1.0 + damping);
        let factor = Factor::new(matrix).ok_or(FitError::Singular)?;
        let right = -(&self.normal.gradient + prior.times(theta));
        Ok(solve(&factor, &right))
    }

    /// Drops the points whose errors are too large to be noise.
    pub fn drop_gross(&mut self, sums: &Assessment) -> Vec<(usize, Dropped)> {
        let mut dropped = Vec::new();
        for (k, own) in sums.chi2.iter().enumerate() {
            match *own {
                None => dropped.push((k, Dropped::Unsolved)),
                Some((chi2, rows)) if tail(rows, chi2) < IMPROBABLE => {
                    self.states[k] = None;
                    dropped.push((k, Dropped::Gross { chi2, rows }));
                }
                Some(_) => {}
            }
        }
        dropped
    }

    /// Takes the prior of the splines with the largest marginal likelihood, and the parameters that fit best
    /// with it in the linear approximation. For each distance of the knots, the priors are climbed to their maximum.
    pub fn choose(
        &mut self,
        theta: &Vector,
        likelihoods: &mut Likelihoods,
        progress: &mut impl FnMut(Progress),
    ) -> Result<Vector, FitError> {
        let smooth = theta.rows(0, self.layout.polynomials(3, 0)).clone_owned();
        let mut best: Option<(f64, Field, Vector)> = None;
        let mut fields = self.job.fields.to_vec();
        fields.sort_by(|a, b| b.knots.total_cmp(&a.knots)); // the coarse knots first: they cost less
        for same_knots in fields.chunk_by(|a, b| a.knots == b.knots) {
            self.change_knots(same_knots[0].knots);
            let centre = smooth.clone().resize_vertically(self.layout.parameters(), 0.0);
            let sums = self.assess(&centre, false).ok_or(FitError::Singular)?;
            // That of the last knots is near the best one of these.
            let start = best.as_ref().map_or(USUAL_FIELD, |(_, field, _)| *field);
            let mut climb = Climb::new(same_knots, start);
            while let Some(field) = climb.next() {
                self.set_field(&field)?;
                let (ln_likelihood, found) = self.likelihood(&centre, sums.data)?;
                climb.judged(ln_likelihood);
                progress(Progress::Prior { field, ln_likelihood });
                likelihoods.push((field, ln_likelihood));
                if best.as_ref().is_none_or(|(ln, ..)| ln_likelihood > *ln) {
                    best = Some((ln_likelihood, field, found));
                }
            }
        }
        let (_, field, found) = best.ok_or(FitError::Singular)?;
        if self.layout.lattices[0].knots() != field.knots {
            self.change_knots(field.knots);
        }
        self.set_field(&field)?;
        Ok(found)
    }

    /// Makes splines with these knots for the points that have not been dropped.
    fn change_knots(&mut self, knots: f64) {
        self.normal = Normal::new(0); // frees its memory before the next one is made
        self.layout = layout(&self.job, &self.states, knots);
        self.bases = bases(&self.job, &self.layout);
        self.normal = Normal::new(self.layout.parameters());
    }

    /// Logarithm of the marginal likelihood of the current prior, up to a constant, and the best parameters.
    fn likelihood(&self, start: &Vector, chi2: f64) -> Result<(f64, Vector), FitError> {
        let prior = self.prior()?;
        let mut matrix = self.normal.matrix.clone();
        prior.add_to(&mut matrix, 1.0);
        let factor = Factor::new(matrix).ok_or(FitError::Singular)?;
        let right = -(&self.normal.gradient + prior.times(start));
        let step = solve(&factor, &right);
        // The data's part of the matrix is the whole less the prior.
        let curvature = step.dot(&right) - step.dot(&prior.times(&step));
        let found = start + &step;
        let chi2 = chi2 + 2.0 * self.normal.gradient.dot(&step) + curvature;
        let cost = chi2 + found.dot(&prior.times(&found));
        Ok((0.5 * (prior.ln_determinant() - cost - factor.ln_determinant()), found))
    }

    pub fn result(
        self,
        theta: &Vector,
        sums: &Assessment,
        (dropped, likelihoods, held_out): (Vec<(usize, Dropped)>, Likelihoods, HeldOut),
    ) -> Result<Fitted, FitError> {
        let cost = sums.data + theta.dot(&self.prior()?.times(theta));
        let mut matrix = self.normal.matrix;
        self.prior.as_ref().ok_or(FitError::Singular)?.add_to(&mut matrix, 1.0);
        let factor = Factor::new(matrix).ok_or(FitError::Singular)?;
        let calibration = Calibration {
            nominal: self.job.nominal.clone(),
            tolerances: self.job.tolerances.clone(),
            layout: self.layout,
            field: self.field,
            theta: theta.as_slice().to_vec(),
            factor,
        };
        let chi2 = sums.chi2.iter().map(|own| own.map(|(chi2, _)| chi2)).collect();
        let (rows, steering) = (sums.rows(), sums.steering.clone());
        Ok(Fitted { calibration, dropped, chi2, cost, rows, likelihoods, held_out, steering, pointing: None })
    }
}

/// The splines that the readings of the points in use touch.
fn layout(job: &Job<'_>, states: &[Option<State>], knots: f64) -> Layout {
    let half_sizes = job.nominal.head.psds.map(|psd| psd.half_size);
    let lattices = [0, 1, 2].map(|i| {
        let used = job.points.iter().zip(states).filter(|(_, state)| state.is_some());
        let spots = used.map(|(point, _)| [point.spots[2 * i], point.spots[2 * i + 1]]);
        Lattice::new(knots, half_sizes[i], spots)
    });
    let runs = job.points.iter().filter_map(|p| p.run).max().map_or(0, |last| last + 1);
    Layout { runs, lattices, half_sizes }
}

fn bases(job: &Job<'_>, layout: &Layout) -> Vec<Basis> {
    job.points.iter().map(|point| layout.basis(&point.spots, point.run)).collect()
}

pub(super) fn solve(factor: &Factor, right: &Vector) -> Vector {
    factor.solve(&Matrix::from_column_slice(right.len(), 1, right.as_slice())).column(0).clone_owned()
}
