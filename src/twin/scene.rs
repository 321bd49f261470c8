//! The light on the three PSDs, for a position of the mirror and of the laser.

use trifacet_optics::{Ellipse, Head, Model, Optics, Pose, Vec2, Vec3};

use super::own_head::{OwnHead, StageFrames};
use super::temperature::Temperature;

/// The light on one PSD: the spot and its fraction of the beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// u and v of the centroid, metres.
    pub at: [f64; 2],
    /// Fraction of the beam.
    pub power: f64,
}

/// The state of mirror, laser and light at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scene {
    /// Pose of the mirror; with `[twin.stage]`, of the table in the axes of the stage.
    pub pose: Pose,
    /// Point where the beam crosses the plane z = 0 of the world frame, x and y, metres.
    pub laser: [f64; 2],
    /// Beam centre minus apex, across the beam, metres.
    pub offset: Vec2,
    /// The light on A, B and C; `None` where no light falls on the sensitive area.
    pub spots: [Option<Spot>; 3],
}

/// The head with a mirror of finite size.
#[derive(Clone, Debug)]
pub struct Lighting {
    optics: Optics,
    mirror_radius: f64,
    /// The shape of the beam, unless it is round.
    ellipse: Option<Ellipse>,
    stage: StageFrames,
    /// The head at the start, and what the temperature changes.
    warming: Option<(Head, Temperature)>,
}

impl Lighting {
    /// The optics of the head, with a mirror of this radius (metres) around the apex.
    pub fn new(head: &Head, mirror_radius: f64) -> Self {
        let (optics, stage) = (Optics::new(head), StageFrames::identity());
        Self { optics, mirror_radius, ellipse: None, stage, warming: None }
    }

    /// The optics of a head of its own.
    pub fn of(own: &OwnHead, mirror_radius: f64) -> Self {
        Self { ellipse: Some(own.ellipse), stage: own.stage, ..Self::new(&own.head, mirror_radius) }
    }

    /// The same with a head that the temperature changes; `head` is that at the start.
    #[must_use]
    pub fn warming(self, head: Head, temperature: Temperature) -> Self {
        Self { warming: Some((head, temperature)), ..self }
    }

    /// Half the side of each PSD, metres.
    pub fn half_sizes(&self) -> [f64; 3] {
        self.optics.half_sizes()
    }

    /// The light on the PSDs, at this temperature after the start. Light that misses the mirror or the sensitive area
    /// of a PSD is lost.
    pub fn scene(&self, pose: Pose, laser: [f64; 2], kelvin: f64) -> Scene {
        let warm =
            self.warming.as_ref().map(|(head, temperature)| Optics::new(&temperature.head(head, kelvin)));
        let optics = warm.as_ref().unwrap_or(&self.optics);
        let mirror = self.stage.mirror(&pose);
        let offset = optics.across(Vec3::new(laser[0], laser[1], 0.0) - mirror.t);
        let mut scene = Scene { pose, laser, offset, spots: [None; 3] };
        if offset.norm() <= self.mirror_radius {
            let (spots, powers) = match &self.ellipse {
                Some(ellipse) => optics.trace_elliptical(ellipse, &mirror, offset),
                None => optics.trace_each(Model::Gaussian, &mirror, offset),
            };
            scene.spots = [0, 1, 2].map(|i| spots[i].ok().map(|at| Spot { at, power: powers[i] }));
        }
        scene
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lighting() -> Lighting {
        Lighting::new(&Head::nominal(0.25, 0.013, 45_f64.to_radians(), 0.46e-3).unwrap(), 5e-3)
    }

    #[test]
    fn the_offset_is_the_laser_seen_from_the_apex() {
        let pose = Pose::from_array([30e-6, -20e-6, 5e-6, 0.0, 0.0, 0.0]);
        let scene = lighting().scene(pose, [10e-6, 15e-6], 0.0);
        assert!((scene.offset - Vec2::new(-20e-6, 35e-6)).norm() < 1e-18);
        let total: f64 = scene.spots.iter().flatten().map(|s| s.power).sum();
        assert!((total - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_beam_beside_the_apex_lights_one_psd_and_beside_the_mirror_none() {
        let lit = |x: f64, y: f64| lighting().scene(Pose::default(), [x, y], 0.0).spots.map(|s| s.is_some());
        assert_eq!(lit(3e-3, 0.0), [true, false, false]);
        assert_eq!(lit(-2e-3, 3e-3), [false, true, false]);
        assert_eq!(lit(4e-3, 4e-3), [false; 3]);
    }

    #[test]
    fn a_spot_beside_its_psd_is_dark_and_the_others_stay() {
        let spots = lighting().scene(Pose::from_array([0.0, 0.0, 0.0, 0.0, 15e-3, 0.0]), [0.0; 2], 0.0).spots;
        assert_eq!(spots.map(|s| s.is_some()), [false, true, true]);
    }
}
