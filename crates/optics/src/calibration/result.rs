//! The calibrated head, and what is not known about its poses.

use nalgebra::{Matrix2, Matrix6, SMatrix, Vector2};
use serde::{Deserialize, Serialize};

use super::Matrix;
use super::cholesky::Factor;
use super::instrument::State;
use super::linearised::{Layout, Neighbours, Response};
use super::map::{Field, polynomials};
use super::parameters::{GEOMETRY, Nominal, Tolerances};
use super::point::Point;
use crate::{Ellipse, Head, Model, Optics, Pose, Relative, Rigid, Vec2};

/// Standard uncertainty of a spot by what the splines cannot follow and by the pitch of the tables, metres.
pub(super) const RESIDUE: f64 = 0.014e-6;

/// A calibrated head with the covariance of its parameters.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The head before the fit.
    pub nominal: Nominal,
    /// Tolerances of the parameters.
    pub tolerances: Tolerances,
    /// What the parameters are.
    pub layout: Layout,
    /// The prior of the splines.
    pub field: Field,
    /// The parameters: differences from the nominal head.
    pub theta: Vec<f64>,
    /// Factor of their inverse covariance.
    pub factor: Factor,
}

/// Readings from which a pose is computed: before any correction table and power gain.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Raw {
    /// u, v of A, B, C in metres.
    pub spots: [f64; 6],
    /// Powers on A, B, C in any unit.
    pub powers: [f64; 3],
}

/// The uncertainty over a range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RangeUncertainty {
    /// Rms over the poses of the range of the standard uncertainty relative to the tare pose: tx, ty, tz
    /// (metres), roll, pitch, yaw (radians).
    pub deviation: [f64; 6],
    /// The largest one of these poses, each axis by itself.
    pub largest: [f64; 6],
    /// Part of the spots in cells that have readings of the calibration, for each PSD.
    pub covered: [f64; 3],
    /// Number of poses.
    pub poses: usize,
}

impl Calibration {
    /// The head, its beam round.
    pub fn head(&self) -> Head {
        self.nominal.head(&self.theta)
    }

    /// Power gains of the PSDs relative to A: reading per true power.
    pub fn power_gains(&self) -> [f64; 3] {
        Nominal::power_gains(&self.theta)
    }

    /// The head and the power gains with which a round beam gives the signals of the elliptical one while the mirror
    /// is at the zero of the reference and the beam on the apex. Without this, the ellipse would shift the pose and
    /// the beam by micrometres, which would contradict the steering.
    pub fn rounded(&self) -> (Head, [f64; 3]) {
        let (mut head, mut gains) = (self.head(), self.power_gains());
        let [stage, table] = self.nominal.frames(&self.theta);
        let (rest, optics) = (Pose::from(&(stage * table)), Optics::new(&head));
        let (round, round_powers) = optics.trace_each(Model::Gaussian, &rest, Vec2::zeros());
        let (spots, powers) = optics.trace_elliptical(&self.ellipse(), &rest, Vec2::zeros());
        for (psd, (round, spot)) in head.psds.iter_mut().zip(round.into_iter().zip(spots)) {
            // Without a spot at rest there is nothing to agree with.
            if let (Ok(round), Ok(spot)) = (round, spot) {
                psd.origin += psd.y * (round[0] - spot[0]) + psd.z * (round[1] - spot[1]);
            }
        }
        let shares = [0, 1, 2].map(|i| powers[i] / round_powers[i]);
        if shares.iter().all(|share| share.is_finite() && *share > 0.0) {
            gains = [0, 1, 2].map(|i| gains[i] * shares[i] / shares[0]);
        }
        (head, gains)
    }

    /// The shape of the beam.
    pub fn ellipse(&self) -> Ellipse {
        Nominal::ellipse(&self.theta)
    }

    /// Matrix and origin (metres) of the steering.
    pub fn steering(&self) -> (Matrix2<f64>, Vector2<f64>) {
        (self.nominal.steering_matrix(&self.theta), self.nominal.steering_origin(&self.theta))
    }

    /// The sensor's world in the frame of the reference, and the reference's table in the frame of the mirror.
    pub fn base_and_tool(&self) -> [Rigid; 2] {
        self.nominal.frames(&self.theta).map(|frame| frame.inverse())
    }

    /// Correction of a reading (u, v) of a PSD (0, 1, 2): true spot minus reading, metres.
    pub fn correction(&self, psd: usize, spot: [f64; 2]) -> [f64; 2] {
        let lattice = &self.layout.lattices[psd];
        let smooth = polynomials(spot, self.layout.half_sizes[psd]);
        [0, 1].map(|coordinate| {
            let at = self.layout.polynomials(psd, coordinate);
            let from = self.layout.splines(psd, coordinate);
            let smooth: f64 = smooth.iter().zip(&self.theta[at..]).map(|(b, c)| b * c).sum();
            smooth + lattice.splines(spot).map(|(place, b)| b * self.theta[from + place]).sum::<f64>()
        })
    }

    /// Standard deviations of the geometric parameters after the fit.
    pub fn deviations(&self) -> Vec<f64> {
        let n = self.theta.len();
        let units = Matrix::from_fn(n, GEOMETRY, |i, j| if i == j { 1.0 } else { 0.0 });
        self.factor.half_solve(&units).column_iter().map(|column| column.norm()).collect()
    }

    /// Covariances by the calibration of the poses of readings relative to the pose of the reading `tare`, in
    /// the frames of the reference: tx, ty, tz in metres, roll, pitch, yaw in radians. A reading without a pose
    /// has no covariance; if the tare has no pose, the result is `None`.
    pub fn relative_covariances(&self, readings: &[Raw], tare: &Raw) -> Option<Vec<Option<Matrix6<f64>>>> {
        let instruments = Neighbours::new(&self.nominal, &self.theta);
        let tare = self.seen(&instruments, tare)?;
        let n = self.theta.len();
        let mut covariances = Vec::with_capacity(readings.len());
        for chunk in readings.chunks(64) {
            let seen: Vec<_> = chunk.iter().map(|reading| self.seen(&instruments, reading)).collect();
            let mut jacobians = Matrix::zeros(n, 6 * chunk.len());
            let mut residues = Vec::with_capacity(chunk.len());
            for (k, seen) in seen.iter().enumerate() {
                residues.push(seen.as_ref().map(|seen| {
                    let Relative { by_pose, by_zero: by_tare, .. } = Relative::new(&seen.pose, &tare.pose);
                    for (part, by) in [(seen, &by_pose), (&tare, &by_tare)] {
                        let own = by * &part.jacobian;
                        for (column, values) in part.columns.iter().zip(own.column_iter()) {
                            for (i, value) in values.iter().enumerate() {
                                jacobians[(*column, 6 * k + i)] += value;
                            }
                        }
                    }
                    let spread = |by: &Matrix6<f64>, spots: &SMatrix<f64, 6, 6>| {
                        let by_spots = by * spots * RESIDUE;
                        by_spots * by_spots.transpose()
                    };
                    spread(&by_pose, &seen.by_spots) + spread(&by_tare, &tare.by_spots)
                }));
            }
            let half = self.factor.half_solve(&jacobians);
            for (k, residue) in residues.into_iter().enumerate() {
                let own = half.columns(6 * k, 6);
                let covariance: Matrix6<f64> = own.tr_mul(&own).fixed_view::<6, 6>(0, 0).into_owned();
                covariances.push(residue.map(|residue| covariance + residue));
            }
        }
        Some(covariances)
    }

    /// Derivatives of the pose of a reading, in the frame of the reference, with respect to the six spots and to the
    /// geometric parameters; `None` if it has no pose.
    pub(super) fn derivatives(&self, instruments: &Neighbours, reading: &Raw) -> Option<[Matrix; 2]> {
        let Seen { by_spots, jacobian, .. } = self.seen(instruments, reading)?;
        let by_spots = Matrix::from_column_slice(6, 6, by_spots.as_slice());
        Some([by_spots, jacobian.columns(0, GEOMETRY).into_owned()])
    }

    fn seen(&self, instruments: &Neighbours, reading: &Raw) -> Option<Seen> {
        let point = reading.point();
        let basis = self.layout.basis(&point.spots, None);
        let response = Response::new(&self.layout, instruments, &self.theta, (&point, &basis), None)?;
        let errors = response.errors;
        let pose = Pose::from_array([0, 1, 2, 3, 4, 5].map(|i| errors[i]));
        let by_spots = response.by_signals.fixed_view::<6, 6>(0, 0).into_owned();
        Some(Seen {
            pose,
            by_spots,
            jacobian: response.jacobian.rows(0, 6).into_owned(),
            columns: basis.columns,
        })
    }

    /// The reading at a pose in the frame of the reference with the beam on the apex; `None` if a PSD gets no
    /// light.
    pub fn reading(&self, pose: &Pose) -> Option<Raw> {
        let instrument = self.nominal.instrument(&self.theta);
        let x: State = instrument.state(pose, Vector2::zeros());
        let signals = instrument.signals(&x)?;
        let mut spots = [0.0; 6];
        for psd in 0..3 {
            let spot = [signals[2 * psd], signals[2 * psd + 1]];
            // The corrections change slowly: ten rounds settle to rounding.
            let mut reading = spot;
            for _ in 0..10 {
                let correction = self.correction(psd, reading);
                reading = [spot[0] - correction[0], spot[1] - correction[1]];
            }
            [spots[2 * psd], spots[2 * psd + 1]] = reading;
        }
        Some(Raw { spots, powers: [6, 7, 8].map(|i| signals[i].exp()) })
    }

    /// The uncertainty of poses within `metres` and `radians` of the zero of the reference on each axis, by
    /// the calibration, for this number of poses; `None` if the zero itself is out of reach.
    pub fn range_uncertainty(&self, metres: f64, radians: f64, poses: usize) -> Option<RangeUncertainty> {
        let tare = self.reading(&Pose::default())?;
        let readings: Vec<Raw> = (0..poses)
            .filter_map(|k| {
                let unit = [2, 3, 5, 7, 11, 13].map(|base| 2.0 * radical_inverse(k + 1, base) - 1.0);
                let [x, y, z, roll, pitch, yaw] = unit;
                let t = [x, y, z].map(|x| x * metres);
                let r = [roll, pitch, yaw].map(|x| x * radians);
                self.reading(&Pose::from_array([t[0], t[1], t[2], r[0], r[1], r[2]]))
            })
            .collect();
        let (mut variance, mut largest) = ([0.0; 6], [0.0_f64; 6]);
        let mut found = 0;
        for covariance in self.relative_covariances(&readings, &tare)?.into_iter().flatten() {
            found += 1;
            for (i, own) in covariance.diagonal().iter().enumerate() {
                variance[i] += own;
                largest[i] = largest[i].max(*own);
            }
        }
        let covered = [0, 1, 2].map(|psd| {
            let inside =
                |r: &&Raw| self.layout.lattices[psd].covers([r.spots[2 * psd], r.spots[2 * psd + 1]]);
            readings.iter().filter(inside).count() as f64 / poses as f64
        });
        (found > 0).then(|| RangeUncertainty {
            deviation: variance.map(|sum| (sum / f64::from(found)).sqrt()),
            largest: largest.map(f64::sqrt),
            covered,
            poses,
        })
    }
}

impl Raw {
    pub(super) fn point(&self) -> Point {
        Point {
            spots: self.spots,
            spot_deviations: [1.0; 6],
            powers: self.powers,
            power_deviations: [1.0; 3],
            reference: [None; 6],
            steering: None,
            run: None,
        }
    }
}

/// A reading as a pose in the frame of the reference, and its derivatives.
struct Seen {
    pose: Pose,
    by_spots: Matrix6<f64>,
    jacobian: Matrix,
    columns: Vec<usize>,
}

/// The `k`th number of the van der Corput sequence: evenly spread over 0 to 1.
pub(super) fn radical_inverse(mut k: usize, base: usize) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0);
    while k > 0 {
        digit /= base as f64;
        value += digit * (k % base) as f64;
        k /= base;
    }
    value
}

#[cfg(test)]
mod tests;
