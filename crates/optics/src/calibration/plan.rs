//! The choice of poses for a calibration: their spots cover the three PSDs evenly.
//!
//! The error of a PSD is known only near the readings of the calibration. Poses are therefore drawn denser
//! towards the limits of the range, and of all candidates the one is taken next whose three spots fall into the
//! cells that were hit least. This halves the largest error of the calibrated head compared with poses at random.

use std::collections::{HashMap, HashSet};
use std::f64::consts::TAU;

use crate::{Model, Optics, Pose, Vec2};

/// Side of a cell of a PSD, metres: spots in the same cell say nearly the same about its error.
pub const CELL: f64 = 0.4e-3;
/// Number of points between two visits of the tare pose. Drift is judged by these visits.
pub const REVISIT: usize = 25;

/// Candidates for each point.
const CANDIDATES: usize = 20;
/// Draws for each candidate, at most.
const DRAWS: usize = 20;

/// What is asked of a plan.
pub struct Request<'a> {
    /// The head, as it is believed to be.
    pub optics: &'a Optics,
    /// Number of poses, without the visits of the tare pose.
    pub points: usize,
    /// Range of tx, ty, tz, roll, pitch, yaw, plus and minus, metres and radians.
    pub range: [f64; 6],
    /// Largest distance of a spot from the middle of its PSD along each axis, metres.
    pub reach: f64,
    /// Whether the beam can follow the apex to this pose.
    pub followed: &'a dyn Fn(&Pose) -> bool,
}

/// A pose of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planned {
    /// Whether it is a visit of the tare pose.
    pub tare: bool,
    /// The pose.
    pub pose: Pose,
}

/// Poses in the order of their measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The poses, with a visit of the tare pose (all coordinates zero) first, after every [`REVISIT`] points, and
    /// last.
    pub poses: Vec<Planned>,
    /// Cells of each PSD.
    pub coverage: [Coverage; 3],
}

/// Cells of a PSD.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coverage {
    /// Cells that a spot of the plan falls into.
    pub hit: usize,
    /// Cells that a spot of any candidate fell into.
    pub within_range: usize,
}

/// Why there is no plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("only {usable} of {drawn} poses in this range can be measured, and {wanted} are needed")]
pub struct RangeError {
    /// Number of poses that can be measured.
    pub usable: usize,
    /// Number of poses that were drawn.
    pub drawn: usize,
    /// Number of poses that are needed.
    pub wanted: usize,
}

/// The cell of a reading, metres.
pub fn cell(u: f64, v: f64) -> [i32; 2] {
    [u, v].map(|x| (x / CELL).floor() as i32)
}

/// The cells of six spot coordinates.
pub fn cells(spots: &[f64; 6]) -> [[i32; 2]; 3] {
    [0, 1, 2].map(|i| cell(spots[2 * i], spots[2 * i + 1]))
}

/// A pose that can be measured, and the cells of its spots.
struct Candidate {
    pose: Pose,
    cells: [[i32; 2]; 3],
}

/// Chooses the poses. `uniform` returns random numbers from 0 to 1; the same numbers give the same plan.
///
/// # Errors
/// Too few poses of the range have all spots within reach and can be followed.
pub fn choose(request: &Request<'_>, uniform: &mut dyn FnMut() -> f64) -> Result<Plan, RangeError> {
    let mut candidates = candidates(request, uniform)?;
    let within_range = [0, 1, 2].map(|i| candidates.iter().map(|c| c.cells[i]).collect::<HashSet<_>>().len());
    let mut hits: [HashMap<[i32; 2], usize>; 3] = Default::default();
    let mut chosen = Vec::with_capacity(request.points);
    for _ in 0..request.points {
        let score = |c: &Candidate| -> usize {
            c.cells.iter().zip(&hits).map(|(cell, hits)| hits.get(cell).copied().unwrap_or(0)).sum()
        };
        // Of equal ones the first: the candidates are in random order.
        let Some(best) = (0..candidates.len()).min_by_key(|k| score(&candidates[*k])) else { break };
        let Candidate { pose, cells } = candidates.swap_remove(best);
        for (hits, cell) in hits.iter_mut().zip(cells) {
            *hits.entry(cell).or_default() += 1;
        }
        chosen.push(pose);
    }
    shuffle(&mut chosen, uniform);
    let coverage = [0, 1, 2].map(|i| Coverage { hit: hits[i].len(), within_range: within_range[i] });
    Ok(Plan { poses: with_visits(&chosen), coverage })
}

/// Draws poses, and keeps those that can be measured.
fn candidates(request: &Request<'_>, uniform: &mut dyn FnMut() -> f64) -> Result<Vec<Candidate>, RangeError> {
    let Request { points, range, .. } = *request;
    let (wanted, mut drawn) = (CANDIDATES * points, 0);
    let mut kept = Vec::with_capacity(wanted);
    while kept.len() < wanted && drawn < DRAWS * wanted {
        drawn += 1;
        // The sine of a uniform angle: denser towards the limits.
        let pose = Pose::from_array(range.map(|limit| limit * (TAU * uniform()).sin()));
        if let Some(cells) = request.cells(&pose) {
            kept.push(Candidate { pose, cells });
        }
    }
    if kept.len() < points {
        return Err(RangeError { usable: kept.len(), drawn, wanted: points });
    }
    Ok(kept)
}

impl Request<'_> {
    /// The cells of the spots at this pose; `None` if it cannot be measured.
    fn cells(&self, pose: &Pose) -> Option<[[i32; 2]; 3]> {
        let reading = self.optics.trace(Model::Gaussian, pose, Vec2::zeros()).ok()?;
        let within = reading.spots.iter().all(|x| x.abs() <= self.reach);
        (within && (self.followed)(pose)).then(|| cells(&reading.spots))
    }
}

/// Puts the poses into random order, so that drift does not look like a dependence on the pose.
fn shuffle(poses: &mut [Pose], uniform: &mut dyn FnMut() -> f64) {
    for k in (1..poses.len()).rev() {
        let other = (uniform() * (k + 1) as f64) as usize;
        poses.swap(k, other.min(k));
    }
}

/// Adds the visits of the tare pose.
fn with_visits(poses: &[Pose]) -> Vec<Planned> {
    let tare = Planned { tare: true, pose: Pose::default() };
    let mut all = vec![tare];
    for block in poses.chunks(REVISIT) {
        all.extend(block.iter().map(|pose| Planned { tare: false, pose: *pose }));
        all.push(tare);
    }
    all
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::Head;

    const RANGE: [f64; 6] = [1e-3, 1e-3, 1e-3, 5e-3, 5e-3, 5e-3];
    const REACH: f64 = 6e-3;

    fn plan(points: usize, range: [f64; 6], seed: u64) -> Result<Plan, RangeError> {
        let (optics, mut rng) = (Optics::new(&Head::default()), Pcg64::seed_from_u64(seed));
        let request = Request { optics: &optics, points, range, reach: REACH, followed: &|_| true };
        choose(&request, &mut || rng.random())
    }

    /// Cells that uniformly distributed poses hit, over the three PSDs.
    fn cells_of_uniform_poses(points: usize, seed: u64) -> usize {
        let (optics, mut rng) = (Optics::new(&Head::default()), Pcg64::seed_from_u64(seed));
        let mut hit: [HashSet<[i32; 2]>; 3] = Default::default();
        for _ in 0..points {
            let pose = Pose::from_array(RANGE.map(|limit| limit * (2.0 * rng.random::<f64>() - 1.0)));
            let reading = optics.trace(Model::Gaussian, &pose, Vec2::zeros()).unwrap();
            hit.iter_mut().zip(cells(&reading.spots)).for_each(|(hit, cell)| _ = hit.insert(cell));
        }
        hit.iter().map(HashSet::len).sum()
    }

    #[test]
    fn a_plan_hits_far_more_cells_than_poses_at_random() {
        for (points, more) in [(100, 1.15), (400, 1.4)] {
            let planned: usize = plan(points, RANGE, 3).unwrap().coverage.iter().map(|c| c.hit).sum();
            let at_random = cells_of_uniform_poses(points, 3);
            assert!(planned as f64 > more * at_random as f64, "{points}: {planned} {at_random}");
        }
    }

    #[test]
    fn a_plan_keeps_its_range_and_its_reach_and_visits_the_tare_pose() {
        let Plan { poses, coverage } = plan(60, RANGE.map(|x| 2.0 * x), 1).unwrap();
        let optics = Optics::new(&Head::default());
        let tares: Vec<usize> = (0..poses.len()).filter(|k| poses[*k].tare).collect();
        assert_eq!(tares, [0, 26, 52, 63]);
        for Planned { pose, tare } in &poses {
            let within = pose.to_array().iter().zip(RANGE).all(|(x, limit)| x.abs() <= 2.0 * limit);
            let reading = optics.trace(Model::Gaussian, pose, Vec2::zeros()).unwrap();
            assert!(within && reading.spots.iter().all(|x| x.abs() <= REACH), "{pose:?}");
            assert!(!tare || *pose == Pose::default());
        }
        assert!(coverage.iter().all(|c| c.hit <= 60 && c.hit < c.within_range), "{coverage:?}");
    }

    #[test]
    fn the_same_seed_gives_the_same_plan_and_another_one_another() {
        assert_eq!(plan(30, RANGE, 5), plan(30, RANGE, 5));
        assert_ne!(plan(30, RANGE, 5), plan(30, RANGE, 6));
    }

    #[test]
    fn a_range_beyond_the_psds_is_refused() {
        let error = plan(30, RANGE.map(|x| 100.0 * x), 1).unwrap_err();
        assert_eq!((error.wanted, error.drawn), (30, DRAWS * CANDIDATES * 30));
        assert!(error.usable < 30, "{error}");
    }
}
