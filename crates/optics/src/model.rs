//! The optical path of a head: from the pose of the mirror and the offset of the beam to spots and powers.

use super::beam::{DARK, Split, Wedge};
use super::ray::Ray;
use super::{FACETS, Head, Mat3, Pose, Psd, Vec2, Vec3};

/// Model of the beam.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// A ray through the apex, as in section 2.2 of the paper: six signals.
    Ray,
    /// A Gaussian beam, split in three by the edges of the mirror: nine signals.
    #[default]
    Gaussian,
}

/// Signals of the PSDs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// u, v of A, B, C in metres.
    pub spots: [f64; 6],
    /// Fractions of the beam on A, B, C; NaN with the ray model, which has no powers.
    pub powers: [f64; 3],
}

/// Reasons why there is no spot.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TraceError {
    /// A pose or an offset is not finite.
    #[error("pose and beam offset must be finite numbers")]
    NotFinite,
    /// The mirror is rotated so far that a facet does not face the light.
    #[error("facet {0} does not face the light")]
    TurnedAway(char),
    /// No light falls on the facet.
    #[error("no light falls on facet {0}")]
    Dark(char),
    /// The reflected light does not travel towards the PSD.
    #[error("the light from facet {0} does not travel towards its PSD")]
    Missed(char),
    /// The light falls outside the sensitive area.
    #[error(
        "the light from facet {facet} falls off its PSD: u = {:.4} mm, v = {:.4} mm, allowed +-{:.4} mm",
        u * 1e3, v * 1e3, half_size * 1e3
    )]
    OffPsd {
        /// A, B or C.
        facet: char,
        /// First coordinate, metres.
        u: f64,
        /// Second coordinate, metres.
        v: f64,
        /// Largest allowed coordinate, metres.
        half_size: f64,
    },
}

/// A head, prepared for computation: everything is expressed in the beam frame, whose z-axis points against
/// the light. For a vertical beam, the beam frame equals the world frame.
#[derive(Clone, Debug)]
pub struct Optics {
    pub(super) psds: [Psd; 3],
    pub(super) facets: [Vec3; 3],
    /// Beam frame to world frame.
    pub(super) to_world: Mat3,
    /// Standard deviation of the Gaussian beam profile per axis, metres.
    pub(super) sigma: f64,
    /// Point from which the beam comes, in the frame of the nominal light; `None`: the beam keeps its direction.
    pub(super) pivot: Option<Vec3>,
}

/// The mirror in the beam frame: position of the apex, and the facet normals.
pub(super) struct Mirror {
    pub t: Vec3,
    pub normals: [Vec3; 3],
}

impl Optics {
    /// Prepares a head.
    pub fn new(head: &Head) -> Self {
        let to_world = turn_from_z(-head.beam_direction);
        let into = to_world.transpose();
        let psds = head.psds.map(|p| Psd {
            origin: into * p.origin,
            x: into * p.x,
            y: into * p.y,
            z: into * p.z,
            half_size: p.half_size,
        });
        Self { psds, facets: head.facets, to_world, sigma: head.beam_diameter / 4.0, pivot: None }
    }

    /// Standard deviation of the Gaussian beam profile per axis, metres: a quarter of the 1/e^2 diameter.
    pub fn sigma(&self) -> f64 {
        self.sigma
    }

    /// Half the side of each PSD, metres.
    pub fn half_sizes(&self) -> [f64; 3] {
        self.psds.map(|p| p.half_size)
    }

    /// The component of a world vector across the beam, in the axes of the beam offset.
    pub fn across(&self, v: Vec3) -> Vec2 {
        (self.to_world.transpose() * v).xy()
    }

    /// The signals for a mirror at `pose` with the centre of the beam at `offset` from the apex, across the
    /// nominal light, metres (world x and y for a vertical beam).
    ///
    /// # Errors
    /// A pose or an offset is not finite, or not all three PSDs see light.
    pub fn trace(&self, model: Model, pose: &Pose, offset: Vec2) -> Result<Reading, TraceError> {
        let (spots, powers) = self.trace_each(model, pose, offset);
        let mut reading = Reading { spots: [0.0; 6], powers };
        for (i, spot) in spots.into_iter().enumerate() {
            [reading.spots[2 * i], reading.spots[2 * i + 1]] = spot?;
        }
        Ok(reading)
    }

    /// As [`Optics::trace`], for each facet: the spot or the reason for its absence, and the fraction of
    /// the beam that the facet reflects (NaN with the ray model).
    pub fn trace_each(
        &self,
        model: Model,
        pose: &Pose,
        offset: Vec2,
    ) -> ([Result<[f64; 2], TraceError>; 3], [f64; 3]) {
        if !(pose.to_array().iter().chain(offset.iter())).all(|x| x.is_finite()) {
            return ([Err(TraceError::NotFinite); 3], [f64::NAN; 3]);
        }
        if let Some((parallel, across)) = self.along_light(pose.t, offset) {
            return parallel.optics.trace_each(model, pose, across);
        }
        let mirror = self.mirror(pose.t, &pose.rotation());
        if let Some(i) = mirror.normals.iter().position(|n| n.z < MIN_FACING) {
            return ([Err(TraceError::TurnedAway(FACETS[i])); 3], [f64::NAN; 3]);
        }
        match model {
            Model::Ray => ([0, 1, 2].map(|i| self.spot(i, &mirror, Vec3::zeros())), [f64::NAN; 3]),
            Model::Gaussian => {
                let split = Split::new(&mirror.normals, offset / self.sigma);
                let wedges = [0, 1, 2].map(|i| split.wedge(i));
                let spots = [0, 1, 2].map(|i| {
                    let lit = wedges[i].power > DARK;
                    let arm = lit.then(|| self.arm(&wedges[i], mirror.normals[i], offset));
                    self.spot(i, &mirror, arm.ok_or(TraceError::Dark(FACETS[i]))?)
                });
                (spots, wedges.map(|w| w.power.max(0.0)))
            }
        }
    }

    /// The mirror in the beam frame, from apex and rotation in the world frame.
    pub(super) fn mirror(&self, t: Vec3, rotation: &Mat3) -> Mirror {
        let into = self.to_world.transpose();
        let r = into * rotation;
        Mirror { t: into * t, normals: self.facets.map(|n| r * n) }
    }

    /// The centroid of the light on a facet, which must not be dark, as seen from the apex.
    #[inline(always)]
    pub(super) fn arm(&self, wedge: &Wedge, normal: Vec3, offset: Vec2) -> Vec3 {
        let rho = offset + wedge.moment * (self.sigma / wedge.power);
        on_plane(normal, rho)
    }

    pub(super) fn spot(&self, facet: usize, mirror: &Mirror, arm: Vec3) -> Result<[f64; 2], TraceError> {
        let psd = &self.psds[facet];
        let ray = Ray::new(psd, mirror.normals[facet], mirror.t + arm);
        if !ray.reaches() {
            return Err(TraceError::Missed(FACETS[facet]));
        }
        let [u, v] = ray.spot;
        if u.abs() > psd.half_size || v.abs() > psd.half_size {
            return Err(TraceError::OffPsd { facet: FACETS[facet], u, v, half_size: psd.half_size });
        }
        Ok(ray.spot)
    }
}

/// A facet is seen edge-on if the component of its normal against the light is smaller than this.
pub(super) const MIN_FACING: f64 = 1e-3;

/// The point of a plane through the origin on the line through `p` along the beam.
#[inline(always)]
pub(super) fn on_plane(normal: Vec3, p: Vec2) -> Vec3 {
    Vec3::new(p.x, p.y, -(normal.x * p.x + normal.y * p.y) / normal.z)
}

/// The smallest rotation that takes the z-axis to the unit vector `to`.
pub(super) fn turn_from_z(to: Vec3) -> Mat3 {
    nalgebra::Rotation3::rotation_between(&Vec3::z(), &to)
        .unwrap_or_else(|| nalgebra::Rotation3::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI))
        .into_inner()
}
