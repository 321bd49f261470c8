//! The covariance of a calibrated pose relative to a tare pose, fast enough for every frame.
//!
//! [`Calibration::relative_covariances`] computes `J N^-1 J'`, which takes milliseconds. Here the covariance of what
//! acts on a pose is kept instead: of the errors of the PSDs as spline coefficients, a few of which act on one
//! reading, and of the geometry. The polynomials of a PSD's error are written as splines. The derivatives of a pose,
//! which change by a few percent over the range, are quadratic functions of the pose. The frame of the reference is
//! left out: an error of it moves pose and tare alike.

use nalgebra::{Matrix6, SMatrix, SVector};
use serde::{Deserialize, Serialize};

use super::Matrix;
use super::linearised::{Layout, Neighbours, coordinates};
use super::map::{Lattice, POLYNOMIALS, polynomials};
use super::parameters::place;
use super::result::{Calibration, RESIDUE};
use crate::quadratic::Quadratic;
use crate::{Pose, Rigid, Vec3};

/// Geometric parameters that act on a pose: all but the steering and the frame of the reference.
const GEOMETRY: usize = 37;
/// Derivatives of a pose with respect to six spots and the geometry.
const SLOPES: usize = 6 * (6 + GEOMETRY);
/// Columns that are computed at a time, for less memory.
const CHUNK: usize = 256;
/// Rounds after which a spot gives its reading to less than a nanometre.
const ROUNDS: usize = 4;

/// The numbers of a [`Spread`], for a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpreadData {
    /// The sensor's world in the frame of the reference, and the table in the frame of the mirror.
    frames: [Rigid; 2],
    knots: f64,
    half_sizes: [f64; 3],
    /// Cells with readings of PSDs A, B, C.
    cells: [Vec<[i32; 2]>; 3],
    slopes: Quadratic,
    /// The coefficients of the errors of the PSDs, metres.
    errors: Vec<f64>,
    /// Covariance of the coefficients: lower triangle, by rows. In double precision: what the data do not tell of the
    /// coefficients is a thousand times what remains of it in a difference of poses.
    maps: Vec<f64>,
    /// Covariance of each coefficient with the geometry.
    cross: Vec<f64>,
    /// Covariance of the geometry.
    geometry: Vec<f64>,
}

/// What a calibration leaves unknown of poses.
#[derive(Clone, Debug, PartialEq)]
pub struct Spread {
    data: SpreadData,
    lattices: [Lattice; 3],
    /// First coefficient of each coordinate.
    starts: [usize; 6],
}

/// A pose to which others are relative.
#[derive(Clone, Debug, PartialEq)]
pub struct Zero {
    at: At,
    /// Covariance of all unknowns with the pose: coefficients, then geometry.
    with: Vec<SVector<f64, 6>>,
    own: Matrix6<f64>,
}

/// The covariance of a pose relative to a zero, in the axes of the sensor's world: of the shift of a point of the
/// mirror (metres), and of the rotation (radians).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relative {
    /// The covariance.
    pub covariance: Matrix6<f64>,
    /// The point, metres.
    pub point: Vec3,
}

/// Derivatives at a pose.
#[derive(Clone, Debug, PartialEq)]
struct At {
    /// The table in the frame of the reference.
    t: Vec3,
    by_spots: Matrix6<f64>,
    by_geometry: SMatrix<f64, 6, GEOMETRY>,
    /// The splines at the readings of A, B, C: place and value.
    splines: [Splines; 3],
}

#[derive(Clone, Debug, PartialEq)]
struct Splines {
    count: usize,
    places: [(usize, f64); 16],
}

impl Splines {
    fn new(lattice: &Lattice, reading: [f64; 2]) -> Self {
        let mut splines = Self { count: 0, places: [(0, 0.0); 16] };
        for (to, from) in splines.places.iter_mut().zip(lattice.splines(reading)) {
            *to = from;
            splines.count += 1;
        }
        splines
    }

    fn iter(&self) -> impl Iterator<Item = (usize, f64)> {
        self.places[..self.count].iter().copied()
    }
}

impl Calibration {
    /// What is unknown of poses within a range to both sides of the zero of the reference, for fast use: metres, radians.
    /// Poses beyond the range have it too, less exactly. `None` if a pose within the range has no reading.
    pub fn spread(&self, range: [f64; 2]) -> Option<Spread> {
        let data = SpreadData {
            frames: self.base_and_tool(),
            knots: self.field.knots,
            half_sizes: self.layout.half_sizes,
            cells: self.layout.lattices.each_ref().map(|lattice| lattice.cells().to_vec()),
            slopes: self.slopes(range)?,
            errors: self.as_splines(),
            maps: Vec::new(),
            cross: Vec::new(),
            geometry: Vec::new(),
        };
        Spread::new(self.with_covariance(data))
    }

    /// Derivatives of a pose in the frame of the reference with respect to the spots and the geometry.
    fn slopes(&self, range: [f64; 2]) -> Option<Quadratic> {
        let instruments = Neighbours::new(&self.nominal, &self.theta);
        Quadratic::new(range, |pose| {
            let pose = Pose::from_array(pose);
            let reading = self.reading(&pose)?;
            let [by_spots, by_geometry] = self.derivatives(&instruments, &reading)?;
            let axes = pose.euler_axes();
            let turned = |mut slopes: Matrix| {
                let angles = axes * slopes.fixed_rows::<3>(3);
                slopes.fixed_rows_mut::<3>(3).copy_from(&angles);
                slopes
            };
            let columns: Vec<usize> = geometry_columns().collect();
            let by_geometry = turned(by_geometry.select_columns(&columns));
            Some(turned(by_spots).iter().chain(by_geometry.iter()).copied().collect())
        })
    }

    /// The errors of the PSDs as spline coefficients.
    fn as_splines(&self) -> Vec<f64> {
        let mut all = Vec::new();
        for (psd, coordinate) in coordinates() {
            let basis = projection(&self.layout, psd);
            let polynomials = &self.theta[self.layout.polynomials(psd, coordinate)..][..POLYNOMIALS];
            let splines = &self.theta[self.layout.splines(psd, coordinate)..];
            all.extend(
                basis
                    .iter()
                    .zip(splines)
                    .map(|(row, fine)| fine + row.iter().zip(polynomials).map(|(b, c)| b * c).sum::<f64>()),
            );
        }
        all
    }

    fn with_covariance(&self, mut data: SpreadData) -> SpreadData {
        let layout = &self.layout;
        let coefficients = data.errors.len();
        let count = coefficients + GEOMETRY;
        let mut unknowns = Matrix::zeros(self.theta.len(), count);
        let mut column = 0;
        for (psd, coordinate) in coordinates() {
            let (smooth, fine) = (layout.polynomials(psd, coordinate), layout.splines(psd, coordinate));
            for (node, row) in projection(layout, psd).iter().enumerate() {
                unknowns.view_mut((smooth, column), (POLYNOMIALS, 1)).copy_from_slice(row);
                unknowns[(fine + node, column)] = 1.0;
                column += 1;
            }
        }
        for parameter in geometry_columns() {
            unknowns[(parameter, column)] = 1.0;
            column += 1;
        }
        let half = self.factor.half_solve(&unknowns);
        drop(unknowns);
        for from in (0..count).step_by(CHUNK) {
            let rows = CHUNK.min(count - from);
            let covariance = half.columns(from, rows).tr_mul(&half.columns(0, from + rows));
            for (i, row) in (from..from + rows).enumerate() {
                if row < coefficients {
                    data.maps.extend((0..=row).map(|k| covariance[(i, k)]));
                }
            }
        }
        let geometry = half.columns(coefficients, GEOMETRY);
        let with_all = geometry.tr_mul(&half);
        data.cross.extend(with_all.columns(0, coefficients).iter());
        data.geometry.extend(with_all.columns(coefficients, GEOMETRY).iter());
        data
    }
}

/// The geometric parameters that act on a pose.
fn geometry_columns() -> impl Iterator<Item = usize> {
    (0..place::MATRIX.at).chain(place::TABLE.range())
}

/// For each spline of a PSD its coefficient in each polynomial: a quasi-interpolation that is exact for cubics.
fn projection(layout: &Layout, psd: usize) -> Vec<[f64; POLYNOMIALS]> {
    let lattice = &layout.lattices[psd];
    let weights = [(-1, -1.0 / 6.0), (0, 8.0 / 6.0), (1, -1.0 / 6.0)];
    let coefficient = |node: &[i32; 2]| {
        let mut row = [0.0; POLYNOMIALS];
        for (i, by_u) in weights {
            for (k, by_v) in weights {
                let knot = [node[0] + i, node[1] + k].map(|x| f64::from(x) * lattice.knots());
                for (sum, value) in row.iter_mut().zip(polynomials(knot, layout.half_sizes[psd])) {
                    *sum += by_u * by_v * value;
                }
            }
        }
        row
    };
    lattice.nodes().iter().map(coefficient).collect()
}

impl Spread {
    /// Takes the numbers of a file; `None` if they do not belong together.
    pub fn new(mut data: SpreadData) -> Option<Self> {
        if !data.half_sizes.iter().all(|half| Lattice::is_usable(data.knots, *half)) {
            return None;
        }
        for cells in &mut data.cells {
            cells.retain(|cell| cell.iter().all(|x| x.abs() < 10_000));
            cells.sort_unstable();
        }
        let lattices =
            [0, 1, 2].map(|i| Lattice::of_cells(data.knots, data.half_sizes[i], data.cells[i].clone()));
        let mut starts = [0; 6];
        let mut n = 0;
        for (start, (psd, _)) in starts.iter_mut().zip(coordinates()) {
            *start = n;
            n += lattices[psd].len();
        }
        let sized = data.errors.len() == n
            && data.maps.len() == n * (n + 1) / 2
            && data.cross.len() == n * GEOMETRY
            && data.geometry.len() == GEOMETRY * GEOMETRY
            && data.slopes.is_usable(SLOPES);
        let numbers = data.errors.iter().chain(&data.maps).chain(&data.cross).chain(&data.geometry);
        let finite = numbers.copied().all(f64::is_finite);
        (sized && finite).then_some(Self { data, lattices, starts })
    }

    /// The numbers, for a file.
    pub fn data(&self) -> &SpreadData {
        &self.data
    }

    /// The mirror at the zero of the reference, in the sensor's world.
    pub fn zero_pose(&self) -> Pose {
        let [base, tool] = self.data.frames;
        Pose::from(&(base.inverse() * tool.inverse()))
    }

    /// The reference's table in the frame of the mirror.
    pub fn table(&self) -> Rigid {
        self.data.frames[1]
    }

    /// A pose of the mirror in the sensor's world as zero, with its spots (corrected, metres).
    pub fn zero(&self, pose: &Pose, spots: &[f64; 6]) -> Zero {
        let at = self.at(pose, spots);
        let n = self.data.errors.len();
        let mut with = vec![SVector::zeros(); n + GEOMETRY];
        for (k, sum) in with.iter_mut().enumerate() {
            for (i, (psd, _)) in coordinates().enumerate() {
                let own: f64 = at.splines[psd]
                    .iter()
                    .map(|(place, w)| w * self.covariance_of(k, self.starts[i] + place))
                    .sum();
                *sum += at.by_spots.column(i) * own;
            }
            for g in 0..GEOMETRY {
                *sum += at.by_geometry.column(g) * self.covariance_of(k, n + g);
            }
        }
        let mut zero = Zero { at, with, own: Matrix6::zeros() };
        zero.own = self.with_zero(&zero.at, &zero)
            + zero.at.by_spots * zero.at.by_spots.transpose() * RESIDUE.powi(2);
        zero
    }

    /// The covariance of two unknowns: coefficients, then geometry.
    fn covariance_of(&self, a: usize, b: usize) -> f64 {
        let n = self.data.errors.len();
        let (a, b) = (a.max(b), a.min(b));
        match (a.checked_sub(n), b.checked_sub(n)) {
            (None, _) => self.data.maps[a * (a + 1) / 2 + b],
            (Some(g), None) => self.data.cross[b * GEOMETRY + g],
            (Some(g), Some(h)) => self.data.geometry[g * GEOMETRY + h],
        }
    }

    /// The covariance of a pose of the mirror in the sensor's world, with its spots (corrected, metres), relative to
    /// a zero.
    pub fn relative(&self, zero: &Zero, pose: &Pose, spots: &[f64; 6]) -> Relative {
        let at = self.at(pose, spots);
        // An error of the zero moves the pose as a rigid body about the place of the zero.
        let mut carried = Matrix6::identity();
        carried.fixed_view_mut::<3, 3>(0, 3).copy_from(&-(at.t - zero.at.t).cross_matrix());
        let mixed = self.with_zero(&at, zero) * carried.transpose();
        let covariance = self.own(&at) - mixed - mixed.transpose() + carried * zero.own * carried.transpose();
        let base = self.data.frames[0].inverse();
        let mut turn = Matrix6::zeros();
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&base.rotation);
        turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&base.rotation);
        Relative {
            covariance: turn * covariance * turn.transpose(),
            point: base.rotation * at.t + base.translation,
        }
    }

    /// Covariance of a pose.
    fn own(&self, at: &At) -> Matrix6<f64> {
        let mut spots = Matrix6::zeros();
        let mut cross = SMatrix::<f64, 6, GEOMETRY>::zeros();
        for (i, (psd, _)) in coordinates().enumerate() {
            for (place, w) in at.splines[psd].iter() {
                let row = self.starts[i] + place;
                let with = &self.data.cross[row * GEOMETRY..][..GEOMETRY];
                cross.row_mut(i).iter_mut().zip(with).for_each(|(sum, c)| *sum += w * c);
                for (k, (other, _)) in coordinates().enumerate().take(i + 1) {
                    let own: f64 = at.splines[other]
                        .iter()
                        .map(|(place, v)| v * self.covariance_of(row, self.starts[k] + place))
                        .sum();
                    spots[(i, k)] += w * own;
                }
            }
        }
        spots.fill_upper_triangle_with_lower_triangle();
        spots += Matrix6::identity() * RESIDUE.powi(2);
        let geometry = SMatrix::<f64, GEOMETRY, GEOMETRY>::from_column_slice(&self.data.geometry);
        let mixed = at.by_spots * cross * at.by_geometry.transpose();
        at.by_spots * spots * at.by_spots.transpose()
            + mixed
            + mixed.transpose()
            + at.by_geometry * geometry * at.by_geometry.transpose()
    }

    /// Covariance of a pose with the zero.
    fn with_zero(&self, at: &At, zero: &Zero) -> Matrix6<f64> {
        let n = self.data.errors.len();
        let mut sum = Matrix6::zeros();
        for (i, (psd, _)) in coordinates().enumerate() {
            let mut spot = SVector::<f64, 6>::zeros();
            for (place, w) in at.splines[psd].iter() {
                spot += zero.with[self.starts[i] + place] * w;
            }
            sum += at.by_spots.column(i) * spot.transpose();
        }
        for g in 0..GEOMETRY {
            sum += at.by_geometry.column(g) * zero.with[n + g].transpose();
        }
        sum
    }

    fn at(&self, pose: &Pose, spots: &[f64; 6]) -> At {
        let [base, tool] = self.data.frames;
        let table = Pose::from(&(base * Rigid::from(pose) * tool));
        let mut slopes = [0.0; SLOPES];
        self.data.slopes.at(&table.to_array(), &mut slopes);
        let (by_spots, by_geometry) = slopes.split_at(36);
        At {
            t: table.t,
            by_spots: Matrix6::from_column_slice(by_spots),
            by_geometry: SMatrix::from_column_slice(by_geometry),
            splines: [0, 1, 2].map(|psd| {
                Splines::new(&self.lattices[psd], self.reading(psd, [spots[2 * psd], spots[2 * psd + 1]]))
            }),
        }
    }

    /// The reading of a PSD at a spot.
    fn reading(&self, psd: usize, spot: [f64; 2]) -> [f64; 2] {
        let mut reading = spot;
        for _ in 0..ROUNDS {
            let mut error = [0.0; 2];
            for (place, w) in self.lattices[psd].splines(reading) {
                for (k, error) in error.iter_mut().enumerate() {
                    *error += w * self.data.errors[self.starts[2 * psd + k] + place];
                }
            }
            reading = [spot[0] - error[0], spot[1] - error[1]];
        }
        reading
    }
}
