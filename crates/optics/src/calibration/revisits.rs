//! Drift during a measurement, from visits of the same pose at different times.
//!
//! At each visit the pose of the nominal head is compared with the reference, and the beam with the readback of the
//! steering. The errors of the head are the same at all visits, so that what changes is drift: of the temperature, of the
//! direction of the laser, of the zero of the reference. Coordinates that change by more than their noise are taken as
//! random walks: their smoothed course is taken off all points, and its uncertainty is added to theirs.

use nalgebra::{SMatrix, Vector2};

use super::fit::tail;
use super::instrument::{Eight, Instrument};
use super::linearised::{noise_of_errors, signals};
use super::parameters::{GEOMETRY, Nominal};
use super::point::Point;
use super::random_walk::{Visit, Walk};

/// Fewest visits from which a drift can be told.
const FEWEST: usize = 4;
/// References that differ by less than this many of their standard uncertainties are the same pose.
const SAME: f64 = 5.0;
/// Visits that differ by noise alone differ as much as this with a smaller probability. Eight coordinates are tested.
const IMPROBABLE: f64 = 1e-4;
/// A visit that is this many standard uncertainties from both its neighbours, ...
const FALSE: f64 = 8.0;
/// ... which differ from each other by less than this part of it, is a false reading, not drift.
const AGREE: f64 = 0.3;

/// Names of the coordinates: those of the pose in the frame of the reference, and the beam at the steering.
pub const COORDINATES: [&str; 8] = ["tx", "ty", "tz", "roll", "pitch", "yaw", "steering x", "steering y"];

/// What the visits of one pose show.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Revisits {
    /// The points that are visits, in the order of their time.
    pub visits: Vec<usize>,
    /// The coordinates that drifted: their place in [`COORDINATES`], and the largest difference between visits after
    /// smoothing; metres, radians.
    pub drifted: Vec<(usize, f64)>,
}

/// Finds the pose that was visited most often, and takes the drift that its visits show off all points: the pose off
/// those of the common zero, the beam off all that have a readback. `times` of the points, in any unit; points of
/// equal time count as measured together.
///
/// # Panics
/// Panics if there are fewer times than points.
pub fn correct(nominal: &Nominal, points: &mut [Point], times: &[f64]) -> Revisits {
    let instrument = nominal.instrument(&[0.0; GEOMETRY]);
    let mut visits = most_visited(points);
    visits.sort_by(|a, b| times[*a].total_cmp(&times[*b]));
    let compared: Vec<(usize, Eight, Eight)> = visits
        .into_iter()
        .filter_map(|k| compare(&instrument, &points[k]).map(|(errors, variances)| (k, errors, variances)))
        .collect();
    let mut found = Revisits { visits: compared.iter().map(|(k, ..)| *k).collect(), drifted: Vec::new() };
    let read_back = compared.iter().all(|(k, ..)| points[*k].steering.is_some());
    let mut walks: [Option<Walk>; 8] = Default::default();
    for (i, walk) in walks.iter_mut().enumerate().take(if read_back { 8 } else { 6 }) {
        let of = |(k, errors, variances): &(usize, Eight, Eight)| Visit {
            time: times[*k],
            value: errors[i],
            variance: variances[i],
        };
        let course = without_false(&compared.iter().map(of).collect::<Vec<_>>());
        if course.len() >= FEWEST && differ(&course) {
            let smoothed = Walk::new(&course);
            found.drifted.push((i, smoothed.range()));
            *walk = Some(smoothed);
        }
    }
    if !found.drifted.is_empty() {
        let matrix = nominal.steering_matrix.try_inverse().unwrap_or_default();
        for (point, time) in points.iter_mut().zip(times) {
            take_off(point, *time, &walks, &matrix);
        }
    }
    found
}

/// The points at the pose at which most points with a whole reference are.
fn most_visited(points: &[Point]) -> Vec<usize> {
    let whole: Vec<usize> = (0..points.len()).filter(|k| points[*k].has_pose()).collect();
    let at = |seed: usize| whole.iter().copied().filter(move |k| same_pose(&points[seed], &points[*k]));
    // Of equal numbers the first: `max_by_key` returns the last.
    let seed = whole.iter().copied().rev().max_by_key(|seed| at(*seed).count());
    seed.map_or_else(Vec::new, |seed| at(seed).collect())
}

fn same_pose(a: &Point, b: &Point) -> bool {
    let pairs = a.reference.iter().zip(&b.reference);
    pairs.into_iter().all(|pair| match pair {
        (Some(a), Some(b)) => (a.value - b.value).abs() <= SAME * a.deviation.hypot(b.deviation),
        _ => false,
    })
}

/// What a point says, less what was measured, and the variances of this; `None` if it has no solution.
fn compare(instrument: &Instrument, point: &Point) -> Option<(Eight, Eight)> {
    let state = instrument.solve(&signals(&point.spots, &point.powers)?, None)?;
    let by_signals = instrument.error_slopes(&state, point) * instrument.slopes(&state)?.try_inverse()?;
    let covariance: SMatrix<f64, 8, 8> = noise_of_errors(&by_signals, instrument, point);
    Some((instrument.errors(&state, point), covariance.diagonal()))
}

/// Whether the visits differ by more than their noise.
fn differ(visits: &[Visit]) -> bool {
    let weights: f64 = visits.iter().map(|v| 1.0 / v.variance).sum();
    let mean = visits.iter().map(|v| v.value / v.variance).sum::<f64>() / weights;
    let chi2 = visits.iter().map(|v| (v.value - mean).powi(2) / v.variance).sum();
    tail(visits.len() - 1, chi2) < IMPROBABLE
}

/// The visits without those that stand alone: a false reading must not draw the points around it.
fn without_false(visits: &[Visit]) -> Vec<Visit> {
    let alone = |k: usize| {
        let (Some(before), Some(after)) = (k.checked_sub(1).and_then(|k| visits.get(k)), visits.get(k + 1))
        else {
            return false;
        };
        let own = visits[k];
        let [from, to] = [own.value - before.value, own.value - after.value];
        let nearest = from.abs().min(to.abs());
        let sigma = (own.variance + before.variance.max(after.variance)).sqrt();
        from * to > 0.0 && nearest > FALSE * sigma && (from - to).abs() < AGREE * nearest
    };
    (0..visits.len()).filter(|k| !alone(*k)).map(|k| visits[k]).collect()
}

/// Moves what was measured at a point to where it would have been without drift.
fn take_off(point: &mut Point, time: f64, walks: &[Option<Walk>; 8], matrix: &nalgebra::Matrix2<f64>) {
    let at = |i: usize| walks[i].as_ref().map_or((0.0, 0.0), |walk| walk.at(time));
    if point.run.is_none() {
        for (i, known) in point.reference.iter_mut().enumerate() {
            if let Some(known) = known {
                let (drift, variance) = at(i);
                known.value += drift;
                known.deviation = (known.deviation.powi(2) + variance).sqrt();
            }
        }
    }
    if let Some(readback) = &mut point.steering {
        let beam = [at(6), at(7)];
        let stage = matrix * Vector2::new(beam[0].0, beam[1].0);
        for (axis, known) in readback.iter_mut().enumerate() {
            known.value += stage[axis];
            known.deviation = (known.deviation.powi(2) + beam[axis].1).sqrt();
        }
    }
}
