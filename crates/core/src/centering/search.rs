//! The search: a spiral over the range of the stage.
//!
//! The turns of the spiral are `PITCH` beam radii apart. No point of the range is therefore farther from
//! the path than three quarters of the beam radius; at that distance all three PSDs receive a few percent of
//! the beam. The beam moves by a quarter of its radius within the loop delay, so that the light is still
//! there when the loop detects it. Points outside the range are skipped.

use std::f64::consts::TAU;

use crate::centering::LoopParams;
use crate::steering::StagePosition;

/// Distance between turns, in beam radii (1/e^2).
const PITCH: f64 = 1.5;
/// Path of the beam within the loop delay, in beam radii.
const REACH: f64 = 0.25;
/// Step along the path where the path is outside the range, as a fraction of the pitch.
const SKIP: f64 = 0.25;
/// Largest number of such steps in one call; the next call continues.
const MOST_SKIPS: u32 = 500;

/// A spiral about a point, in the axes of the stage, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spiral {
    centre: StagePosition,
    /// Radians from the start.
    angle: f64,
    pitch: f64,
    speed: f64,
    /// The range of each axis: plus and minus this.
    limit: f64,
}

impl Spiral {
    /// A spiral from `centre` over the range of plus and minus `limit`. `radius` is the radius of the beam in
    /// lengths of the stage, `delay_s` the loop delay. The speed is at most `slew`, metres per second.
    pub fn new(centre: StagePosition, radius: f64, delay_s: f64, limit: f64, slew: f64) -> Self {
        let speed = (REACH * radius / delay_s).min(slew);
        Self { centre, angle: 0.0, pitch: PITCH * radius, speed, limit }
    }

    /// The spiral for a loop with these parameters and a beam with this radius, metres.
    pub fn of(params: &LoopParams, centre: StagePosition, radius: f64) -> Self {
        let controller = &params.controller;
        let radius = radius / params.map.largest_gain();
        Self::new(centre, radius, params.loop_delay_s, controller.limit, controller.slew)
    }

    /// The next point, `dt` seconds after the last one; `None` when the whole range has been covered.
    pub fn next(&mut self, dt: f64) -> Option<StagePosition> {
        self.advance(self.speed * dt);
        for _ in 0..MOST_SKIPS {
            let point = self.point();
            if self.radius() > self.farthest() {
                return None;
            }
            // Just outside the range the path runs along the edge; otherwise it would pass the edge too far
            // away.
            if point.iter().all(|p| p.abs() <= self.limit + 0.5 * self.pitch) {
                return Some(self.within(point));
            }
            self.advance(SKIP * self.pitch);
        }
        Some(self.within(self.point()))
    }

    fn within(&self, point: StagePosition) -> StagePosition {
        StagePosition(point.map(|p| p.clamp(-self.limit, self.limit)))
    }

    /// Time until the whole range is covered, seconds, for one point every `dt` seconds. Infinite if that
    /// takes more than ten million points.
    pub fn duration(mut self, dt: f64) -> f64 {
        (0..10_000_000_u32).find(|_| self.next(dt).is_none()).map_or(f64::INFINITY, |n| f64::from(n) * dt)
    }

    fn radius(&self) -> f64 {
        self.pitch * self.angle / TAU
    }

    fn point(&self) -> StagePosition {
        let (sin, cos) = self.angle.sin_cos();
        StagePosition([self.centre[0] + self.radius() * cos, self.centre[1] + self.radius() * sin])
    }

    /// Moves along the path by a length, using the radius at the middle of the step.
    fn advance(&mut self, length: f64) {
        let turn = |angle: f64| length / (self.pitch / TAU) / angle.hypot(1.0);
        self.angle += turn(self.angle + 0.5 * turn(self.angle));
    }

    /// Distance from the centre to the farthest corner of the range, plus one turn so that the last turn is
    /// complete.
    fn farthest(&self) -> f64 {
        let [x, y] = self.centre.map(|c| c.abs() + self.limit);
        x.hypot(y) + self.pitch
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RADIUS: f64 = 0.23e-3;
    const DELAY: f64 = 0.4e-3;
    const DT: f64 = 1e-4;

    fn path(centre: StagePosition, limit: f64) -> Vec<StagePosition> {
        let mut spiral = Spiral::new(centre, RADIUS, DELAY, limit, 1.0);
        std::iter::from_fn(|| spiral.next(DT)).collect()
    }

    #[test]
    fn every_point_of_the_range_is_passed_within_three_quarters_of_the_radius() {
        for centre in [[0.0; 2], [0.9e-3, -0.4e-3], [1e-3, 1e-3]] {
            let path = path(StagePosition(centre), 1e-3);
            for k in 0..21 * 21 {
                let at = [k % 21, k / 21].map(|i| f64::from(i - 10) * 0.1e-3);
                let nearest = path.iter().map(|p| (p[0] - at[0]).hypot(p[1] - at[1])).fold(1.0, f64::min);
                assert!(nearest < 0.78 * RADIUS, "{at:?} {nearest}");
            }
            assert!(path.iter().flat_map(|p| p.0).all(|p| p.abs() <= 1e-3));
        }
    }

    #[test]
    fn the_search_moves_at_its_speed() {
        let path = path(StagePosition([0.0; 2]), 2e-3);
        let speed = 0.25 * RADIUS / DELAY;
        let inside = |p: &StagePosition| p[0].hypot(p[1]) < 1.9e-3;
        for pair in path.windows(2).take_while(|pair| inside(&pair[1])) {
            let step = (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
            assert!(step <= 1.03 * speed * DT, "{step}");
        }
        let said = Spiral::new(StagePosition([0.0; 2]), RADIUS, DELAY, 2e-3, 1.0).duration(DT);
        assert!((path.len() as f64 * DT / said - 1.0).abs() < 0.01, "{said}");
    }

    #[test]
    fn the_slew_limit_is_kept() {
        let mut slow = Spiral::new(StagePosition([0.0; 2]), RADIUS, DELAY, 1e-3, 0.01);
        let mut last = [0.0; 2];
        for _ in 0..1000 {
            let next = slow.next(DT).unwrap();
            assert!((next[0] - last[0]).hypot(next[1] - last[1]) <= 1.03e-6);
            last = next.0;
        }
    }
}
