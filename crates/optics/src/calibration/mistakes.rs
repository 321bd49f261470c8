//! What is plainly wrong before any fit: signs, axes, units, exchanged PSDs.
//!
//! The poses of the nominal head follow the reference within a few percent, whatever the tolerances. The matrix
//! of a regression of one on the other shows what does not.

use nalgebra::{Matrix2, Matrix3, Matrix6, Vector6};

use super::instrument::{Instrument, State};
use super::linearised::signals;
use super::parameters::{GEOMETRY, Nominal};
use super::point::Point;
use crate::{FACETS, Pose, Rigid};

/// An element of the matrix may differ from the identity by this.
const LIMIT: f64 = 0.2;
/// The same for the steering, whose matrix is less well known.
const STEERING_LIMIT: f64 = 0.5;
/// Angles are compared with translations by this length, metres.
const ARM: f64 = 0.25;
/// An axis counts as moved if it moves by this part of the axis of its kind that moves most,
const MOVED: f64 = 0.02;
/// and by this rms, metres.
const LEAST: f64 = 5e-6;
/// Number of points that are enough for the test.
const ENOUGH: usize = 200;
/// Fewer points show nothing.
const FEWEST: usize = 8;

const AXES: [&str; 6] = ["tx", "ty", "tz", "roll", "pitch", "yaw"];

/// The regression of the poses of the nominal head on the reference.
#[derive(Clone, Debug, PartialEq)]
pub struct Regression {
    /// Change of the pose (rows) per change of the reference (columns), angles times 0.25 m.
    pub matrix: Matrix6<f64>,
    /// Axes that the reference has moved.
    pub moved: [bool; 6],
    /// Rms of the difference from the reference, relative to the point nearest to its zero: metres, radians;
    /// NaN without points that have all six coordinates.
    pub rms: [f64; 6],
    /// Number of points.
    pub points: usize,
}

/// Solves the points as the nominal head and compares them with the reference.
///
/// # Errors
/// What is wrong, by name.
pub fn check(nominal: &Nominal, points: &[Point]) -> Result<Option<Regression>, String> {
    let instrument = nominal.instrument(&[0.0; GEOMETRY]);
    let with_reference: Vec<&Point> =
        points.iter().filter(|p| p.run.is_none() && p.reference.iter().any(Option::is_some)).collect();
    let every = with_reference.len().div_ceil(ENOUGH).max(1);
    let some: Vec<&Point> = with_reference.iter().copied().step_by(every).collect();
    let same = |point: &Point| point.clone();
    let regression = regression(&instrument, &some, same);
    if let Some(found) = &regression
        && found.off(&Matrix6::identity()) > LIMIT
    {
        return Err(name(&instrument, &some, found));
    }
    if regression.is_none()
        && some.len() >= FEWEST
        && let Some(wrong) = exchanged(&instrument, &some)
    {
        return Err(wrong);
    }
    steering(&instrument, nominal, points)?;
    Ok(regression)
}

impl Regression {
    /// Largest difference from the identity if the reference is corrected by this matrix.
    fn off(&self, correction: &Matrix6<f64>) -> f64 {
        let matrix = self.matrix * correction;
        let columns = (0..6).filter(|j| self.moved[*j]);
        let elements = columns.flat_map(|j| (0..6).map(move |i| (i, j)));
        let off = |(i, j)| (matrix[(i, j)] - if i == j { 1.0 } else { 0.0 }).abs();
        elements.map(off).fold(0.0, f64::max)
    }
}

/// Poses of the points, changed as given, in the frame of the reference; `None` for a point without a solution.
fn poses(instrument: &Instrument, points: &[&Point], change: impl Fn(&Point) -> Point) -> Vec<Option<Pose>> {
    let solve = |point: &&Point| {
        let point = change(point);
        let state: State = instrument.solve(&signals(&point.spots, &point.powers)?, None)?;
        let bare = Point { reference: [None; 6], ..point };
        let errors = instrument.errors(&state, &bare);
        Some(Pose::from_array([0, 1, 2, 3, 4, 5].map(|i| errors[i])))
    };
    points.iter().map(solve).collect()
}

fn scaled(pose: [f64; 6]) -> Vector6<f64> {
    Vector6::from_fn(|i, _| if i < 3 { pose[i] } else { pose[i] * ARM })
}

/// Change of the reference and of the pose, scaled.
type Pair = (Vector6<f64>, Vector6<f64>);

/// `None` if too few points have a solution.
fn regression(
    instrument: &Instrument,
    points: &[&Point],
    change: impl Fn(&Point) -> Point,
) -> Option<Regression> {
    let poses = poses(instrument, points, change);
    let solved: Vec<(&Point, Pose)> =
        points.iter().zip(&poses).filter_map(|(point, pose)| Some((*point, (*pose)?))).collect();
    if solved.len() < FEWEST || 2 * solved.len() < points.len() {
        return None;
    }
    let full: Vec<_> = solved.iter().filter(|(point, _)| point.has_pose()).collect();
    let size = |point: &Point| scaled(point.reference_values()).norm();
    let nearest = full.iter().min_by(|a, b| size(a.0).total_cmp(&size(b.0)));
    let mut rms = [f64::NAN; 6];
    let mut pairs: Vec<Pair> = Vec::new();
    if let (Some((zero, zero_pose)), true) = (nearest, full.len() >= 3 * FEWEST) {
        let from = Rigid::from(&Pose::from_array(zero.reference_values())).inverse();
        let own_from = Rigid::from(zero_pose).inverse();
        let mut squares = Vector6::zeros();
        for (point, pose) in &full {
            let moved = from * Rigid::from(&Pose::from_array(point.reference_values()));
            let found = Pose::from(&(own_from * Rigid::from(pose))).to_array();
            let wanted = Pose::from(&moved).to_array();
            squares += (Vector6::from(found) - Vector6::from(wanted)).map(|x| x * x);
            // Differences, not compositions: angles in a wrong unit must not turn the translations.
            pairs.push((scaled(point.reference_values()), scaled(pose.to_array())));
        }
        rms = squares.map(|sum| (sum / full.len() as f64).sqrt()).into();
    } else {
        // Axes that are not measured do not move on purpose.
        let known = |point: &Point| point.reference_values().map(|x| if x.is_nan() { 0.0 } else { x });
        pairs.extend(solved.iter().map(|(p, pose)| (scaled(known(p)), scaled(pose.to_array()))));
    }
    let n = pairs.len() as f64;
    let mean = |which: fn(&Pair) -> Vector6<f64>| pairs.iter().map(which).sum::<Vector6<f64>>() / n;
    let (mean_in, mean_out) = (mean(|p| p.0), mean(|p| p.1));
    let (mut inner, mut outer) = (Matrix6::zeros(), Matrix6::zeros());
    for (wanted, found) in &pairs {
        let wanted = wanted - mean_in;
        inner += wanted * wanted.transpose();
        outer += (found - mean_out) * wanted.transpose();
    }
    let moved = [0, 1, 2, 3, 4, 5].map(|i| {
        let largest = inner.diagonal().fixed_rows::<3>(i / 3 * 3).max();
        inner[(i, i)] > MOVED * MOVED * largest && inner[(i, i)] > n * LEAST * LEAST
    });
    for i in (0..6).filter(|i| !moved[*i]) {
        inner.fill_row(i, 0.0);
        inner.fill_column(i, 0.0);
        inner[(i, i)] = 1.0;
        outer.fill_column(i, 0.0);
    }
    Some(Regression { matrix: outer * inner.try_inverse()?, moved, rms, points: pairs.len() })
}

/// What makes the regression differ from the identity.
fn name(instrument: &Instrument, points: &[&Point], found: &Regression) -> String {
    if let Some(wrong) = reference_mistake(found) {
        return wrong;
    }
    if let Some(wrong) = exchanged(instrument, points) {
        return wrong;
    }
    let columns = (0..6).filter(|j| found.moved[*j]);
    let elements = columns.flat_map(|j| (0..6).map(move |i| (i, j)));
    let off = |(i, j): (usize, usize)| (found.matrix[(i, j)] - if i == j { 1.0 } else { 0.0 }).abs();
    let (i, j) = elements.max_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap_or((0, 0));
    format!(
        "the poses of the nominal head do not follow the reference: {} changes by {:.3} times the change of \
         ref_{} (angles times 0.25 m), expected is {:.0} within {LIMIT}; check axes, signs and units of the \
         reference, and the wiring of the PSDs",
        AXES[i],
        found.matrix[(i, j)],
        AXES[j],
        if i == j { 1.0 } else { 0.0 },
    )
}

/// Units of translations: factor from the reference to metres.
const LENGTHS: [(f64, &str); 7] = [
    (1.0, ""),
    (25.4, "are in inches where millimetres are meant"),
    (1.0 / 25.4, "are in millimetres where inches are meant"),
    (1e3, "are a thousand times too small: check the unit"),
    (1e-3, "are a thousand times too large: check the unit"),
    (1e-6, "are a million times too large: micrometres instead of metres"),
    (0.0254, "are in inches instead of metres"),
];
/// Units of angles: factor from the reference to radians.
const ANGLES: [(f64, &str); 8] = [
    (1.0, ""),
    (0.017_453_292_519_943_295, "are in degrees instead of radians"),
    (57.295_779_513_082_32, "are divided by 57.3: radians were converted as if they were degrees"),
    (4.848_136_811_095_36, "are in seconds of arc where microradians are meant"),
    (0.206_264_806_247_096_36, "are in microradians where seconds of arc are meant"),
    (4.848_136_811_095_36e-6, "are in seconds of arc instead of radians"),
    (1e3, "are a thousand times too small: check the unit"),
    (1e-3, "are a thousand times too large: check the unit"),
];

/// A sign, an exchange of axes or a unit of the reference that explains the regression.
fn reference_mistake(found: &Regression) -> Option<String> {
    let (lengths, t) = best_block(found, 0, &LENGTHS);
    let (angles, r) = best_block(found, 3, &ANGLES);
    let mut correction = Matrix6::zeros();
    correction.fixed_view_mut::<3, 3>(0, 0).copy_from(&t);
    correction.fixed_view_mut::<3, 3>(3, 3).copy_from(&r);
    if found.off(&correction) > LIMIT {
        return None;
    }
    let mut wrong = Vec::new();
    for (unit, what) in
        [(lengths, "the translations of the reference"), (angles, "the angles of the reference")]
    {
        if !unit.is_empty() {
            wrong.push(format!("{what} {unit}"));
        }
    }
    for (from, block) in [(0, t), (3, r)] {
        for i in 0..3 {
            let (from_axis, value) = (0..3).map(|j| (j, block[(i, j)])).find(|(_, x)| *x != 0.0)?;
            if from_axis > i || from_axis != i && block[(from_axis, i)] == 0.0 {
                wrong.push(format!(
                    "ref_{} and ref_{} are exchanged",
                    AXES[from + i],
                    AXES[from + from_axis]
                ));
            }
            if value < 0.0 {
                wrong.push(format!("the sign of ref_{} is reversed", AXES[from + from_axis]));
            }
        }
    }
    Some(wrong.join("; "))
}

/// The unit, and the exchange of axes with their signs, that bring a block closest to the identity.
fn best_block(
    found: &Regression,
    from: usize,
    units: &[(f64, &'static str)],
) -> (&'static str, Matrix3<f64>) {
    let orders = [[0, 1, 2], [1, 0, 2], [0, 2, 1], [2, 1, 0], [1, 2, 0], [2, 0, 1]];
    let block = found.matrix.fixed_view::<3, 3>(from, from).into_owned();
    let mut best = (f64::INFINITY, "", Matrix3::identity());
    if !(0..3).any(|i| found.moved[from + i]) {
        return (best.1, best.2);
    }
    for (unit, text) in units {
        for order in orders {
            for signs in 0..8 {
                let mut turn = Matrix3::zeros();
                for (i, j) in order.into_iter().enumerate() {
                    turn[(i, j)] = if signs >> i & 1 == 1 { -1.0 } else { 1.0 };
                }
                // block = (unit * turn): the reference is corrected by its product.
                let inverse = turn.transpose() / *unit;
                let product = block * inverse;
                let wrong = (0..3)
                    .filter(|j| found.moved[from + order[*j]])
                    .flat_map(|j| (0..3).map(move |i| (i, j)));
                let off = wrong.map(|(i, j)| (product[(i, j)] - if i == j { 1.0 } else { 0.0 }).abs());
                let off = off.fold(0.0, f64::max);
                // Of two that explain the same, the one earlier in the lists is simpler.
                if off < best.0 - 1e-9 {
                    best = (off, text, inverse);
                }
            }
        }
    }
    (best.1, best.2)
}

/// An exchange of PSDs or a reversed axis of one that explains the regression.
fn exchanged(instrument: &Instrument, points: &[&Point]) -> Option<String> {
    let explains = |change: &dyn Fn(&Point) -> Point| {
        regression(instrument, points, change).is_some_and(|r| r.off(&Matrix6::identity()) <= LIMIT)
    };
    for order in [[0, 2, 1], [1, 0, 2], [2, 1, 0], [1, 2, 0], [2, 0, 1]] {
        let change = |point: &Point| {
            let mut new = point.clone();
            for (to, from) in order.into_iter().enumerate() {
                new.powers[to] = point.powers[from];
                for k in 0..2 {
                    new.spots[2 * to + k] = point.spots[2 * from + k];
                }
            }
            new
        };
        if explains(&change) {
            let wrong = (0..3).filter(|i| order[*i] != *i).map(|i| FACETS[i].to_string());
            return Some(format!("PSDs {} are exchanged", wrong.collect::<Vec<_>>().join(" and ")));
        }
    }
    for i in 0..6 {
        let change = |point: &Point| {
            let mut new = point.clone();
            new.spots[i] = -new.spots[i];
            new
        };
        if explains(&change) {
            let axis = if i % 2 == 0 { "u" } else { "v" };
            return Some(format!("the sign of {axis} of PSD {} is reversed", FACETS[i / 2]));
        }
    }
    None
}

/// The readback of the steering must follow the beam.
fn steering(instrument: &Instrument, nominal: &Nominal, points: &[Point]) -> Result<(), String> {
    let with: Vec<&Point> = points.iter().filter(|p| p.steering.is_some()).collect();
    let every = with.len().div_ceil(ENOUGH).max(1);
    let (mut inner, mut outer, mut count) = (Matrix2::zeros(), Matrix2::zeros(), 0);
    let mut pairs = Vec::new();
    for point in with.into_iter().step_by(every) {
        let Some([x, y]) = point.steering else { continue };
        let solved = signals(&point.spots, &point.powers).and_then(|s| instrument.solve(&s, None));
        let Some(state) = solved else { continue };
        let bare = Point { steering: None, ..point.clone() };
        let beam = instrument.errors(&state, &bare).fixed_rows::<2>(6) + nominal.steering_origin;
        pairs.push((nalgebra::Vector2::new(x.value, y.value), beam));
        count += 1;
    }
    if count < FEWEST {
        return Ok(());
    }
    let n = f64::from(u32::try_from(count).unwrap_or(u32::MAX));
    let (mean_in, mean_out) =
        pairs.iter().fold((nalgebra::Vector2::zeros(), nalgebra::Vector2::zeros()), |(a, b), (x, y)| {
            (a + x / n, b + y / n)
        });
    for (readback, beam) in &pairs {
        let readback = readback - mean_in;
        inner += readback * readback.transpose();
        outer += (beam - mean_out) * readback.transpose();
    }
    let Some(inverse) = inner.try_inverse() else { return Ok(()) };
    let found = outer * inverse;
    let off = (found - nominal.steering_matrix).abs().max();
    if off > STEERING_LIMIT {
        let e = |i, j| found[(i, j)];
        return Err(format!(
            "the readback of the steering does not follow the beam: the matrix of the data is [[{:.3}, {:.3}], \
             [{:.3}, {:.3}]]; set steering.matrix in the configuration, or check axes, signs and unit of the \
             readback",
            e(0, 0),
            e(0, 1),
            e(1, 0),
            e(1, 1)
        ));
    }
    Ok(())
}
