//! The geometric parameters of a head on its stage, and their tolerances.

use nalgebra::{Matrix2, Rotation3, Vector2};
use serde::{Deserialize, Serialize};

use super::instrument::Instrument;
use crate::model::turn_from_z;
use crate::{Ellipse, Head, Mat3, Rigid, Vec3};

/// Number of geometric parameters.
pub const GEOMETRY: usize = place::GROUPS[place::GROUPS.len() - 1].end;

/// What is known before the fit: the head as drawn, and how it is mounted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Nominal {
    /// The head as drawn.
    pub head: Head,
    /// Displacement of the beam per axis of the steering stage.
    pub steering_matrix: Matrix2<f64>,
    /// Position of the beam across the beam with the steering stage at zero, metres.
    pub steering_origin: Vector2<f64>,
    /// The frame of the reference in the sensor's world.
    pub stage: Rigid,
    /// The mirror in the frame of the reference's table: its inverse takes the mirror to the table.
    pub table: Rigid,
}

/// Standard deviations of the parameters before any data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Tolerances {
    /// Position of a PSD along each of its axes, millimetres.
    pub psd_position_mm: f64,
    /// Rotation of a PSD about each of its axes, milliradians.
    pub psd_rotation_mrad: f64,
    /// Direction of a facet normal in each of two directions, milliradians.
    pub facet_mrad: f64,
    /// Direction of the light, milliradians.
    pub beam_mrad: f64,
    /// Diameter of the beam, percent.
    pub diameter_percent: f64,
    /// Ellipticity of the beam, percent of its variance.
    pub ellipticity_percent: f64,
    /// Gains of the powers of B and C relative to A, percent.
    pub power_gain_percent: f64,
    /// Each element of the steering matrix, percent.
    pub steering_matrix_percent: f64,
    /// Scale and shear of the steering, percent, if it is known better than the elements of the matrix.
    pub steering_scale_percent: Option<f64>,
    /// Origin of the steering, millimetres.
    pub steering_origin_mm: f64,
    /// Frames of reference and mirror: position, millimetres.
    pub frame_mm: f64,
    /// Frames of reference and mirror: rotation, milliradians.
    pub frame_mrad: f64,
    /// Polynomial error of a PSD by degree, 1 to 7: each coefficient, micrometres at the edge.
    pub psd_error_um: [f64; 7],
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            psd_position_mm: 1.0,
            psd_rotation_mrad: 10.0,
            facet_mrad: 3.0,
            beam_mrad: 2.0,
            diameter_percent: 10.0,
            ellipticity_percent: 3.0,
            power_gain_percent: 5.0,
            steering_matrix_percent: 20.0,
            steering_scale_percent: None,
            steering_origin_mm: 1.0,
            frame_mm: 5.0,
            frame_mrad: 20.0,
            psd_error_um: [50.0, 100.0, 150.0, 30.0, 30.0, 10.0, 10.0],
        }
    }
}

impl Tolerances {
    /// What is wrong with a value; `None`: all are usable.
    pub fn wrong(&self) -> Option<String> {
        let singles = [
            ("psd_position_mm", self.psd_position_mm),
            ("psd_rotation_mrad", self.psd_rotation_mrad),
            ("facet_mrad", self.facet_mrad),
            ("beam_mrad", self.beam_mrad),
            ("diameter_percent", self.diameter_percent),
            ("ellipticity_percent", self.ellipticity_percent),
            ("power_gain_percent", self.power_gain_percent),
            ("steering_matrix_percent", self.steering_matrix_percent),
            ("steering_scale_percent", self.steering_scale_percent.unwrap_or(1.0)),
            ("steering_origin_mm", self.steering_origin_mm),
            ("frame_mm", self.frame_mm),
            ("frame_mrad", self.frame_mrad),
        ];
        let all = singles.into_iter().chain(self.psd_error_um.map(|um| ("psd_error_um", um)));
        // False for a NaN.
        let usable = |x: f64| (1e-9..=1e6).contains(&x);
        let (name, value) = all.into_iter().find(|(_, value)| !usable(*value))?;
        Some(format!("{name} is {value}: allowed is 1e-9 to 1e6"))
    }
}

/// Parameters of one kind, which follow each other in the vector of all.
#[derive(Clone, Copy, Debug)]
pub(super) struct Group {
    /// Place of the first one.
    pub at: usize,
    /// Place after the last one.
    end: usize,
    /// Step of each for its difference quotient, in its unit.
    step: f64,
}

impl Group {
    /// The first group, of this number of parameters.
    const fn first(count: usize, step: f64) -> Self {
        Self { at: 0, end: count, step }
    }

    /// The group after this one.
    const fn then(self, count: usize, step: f64) -> Self {
        Self { at: self.end, end: self.end + count, step }
    }

    /// The places of its parameters.
    pub fn range(self) -> std::ops::Range<usize> {
        self.at..self.end
    }
}

/// The groups of parameters. A new one, such as the pivot of a mirror that steers the beam, is a line here and in
/// [`GROUPS`](place::GROUPS), its names and tolerances in [`parameters`], and its effect in [`Nominal`].
pub(super) mod place {
    use super::Group;

    /// Step of lengths and angles: metres, radians.
    const GEOMETRIC: f64 = 1e-5;
    /// Step of ratios.
    const RATIO: f64 = 1e-4;

    /// Six per PSD: shift along its normal, u, v; rotation about them.
    pub const PSD: Group = Group::first(18, GEOMETRIC);
    /// Two per facet: towards the zenith, about it.
    pub const FACET: Group = PSD.then(6, GEOMETRIC);
    /// Direction of the light.
    pub const BEAM: Group = FACET.then(2, GEOMETRIC);
    /// Logarithm of the diameter.
    pub const DIAMETER: Group = BEAM.then(1, RATIO);
    /// Ellipse.
    pub const ELLIPSE: Group = DIAMETER.then(2, RATIO);
    /// Logarithms of the power gains of B and C.
    pub const GAIN: Group = ELLIPSE.then(2, RATIO);
    /// Steering matrix, by rows.
    pub const MATRIX: Group = GAIN.then(4, RATIO);
    /// Steering origin.
    pub const ORIGIN: Group = MATRIX.then(2, GEOMETRIC);
    /// Frame of the reference: rotation, translation.
    pub const STAGE: Group = ORIGIN.then(6, GEOMETRIC);
    /// Frame of the mirror: rotation, translation.
    pub const TABLE: Group = STAGE.then(6, GEOMETRIC);

    /// All groups, in their order.
    pub const GROUPS: [Group; 10] = [PSD, FACET, BEAM, DIAMETER, ELLIPSE, GAIN, MATRIX, ORIGIN, STAGE, TABLE];
}

/// One geometric parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// Unit: "m", "rad" or "1".
    pub unit: String,
    /// Standard deviation before any data.
    pub deviation: f64,
}

/// The parameters in their order.
pub fn parameters(t: &Tolerances) -> Vec<Parameter> {
    let mut list = Vec::with_capacity(GEOMETRY);
    let mut add = |name: String, unit: &str, deviation: f64| {
        list.push(Parameter { name, unit: unit.to_owned(), deviation });
    };
    let (mm, mrad, percent) = (1e-3, 1e-3, 1e-2);
    for psd in ["a", "b", "c"] {
        for axis in ["normal", "u", "v"] {
            add(format!("psd_{psd}.position_{axis}"), "m", t.psd_position_mm * mm);
        }
        for axis in ["normal", "u", "v"] {
            add(format!("psd_{psd}.rotation_{axis}"), "rad", t.psd_rotation_mrad * mrad);
        }
    }
    for facet in ["a", "b", "c"] {
        add(format!("facet_{facet}.towards_zenith"), "rad", t.facet_mrad * mrad);
        add(format!("facet_{facet}.about_zenith"), "rad", t.facet_mrad * mrad);
    }
    for axis in ["x", "y"] {
        add(format!("beam.direction_{axis}"), "rad", t.beam_mrad * mrad);
    }
    add("beam.ln_diameter".to_owned(), "1", t.diameter_percent * percent);
    for part in ["xx", "xy"] {
        add(format!("beam.ellipse_{part}"), "1", t.ellipticity_percent * percent);
    }
    for psd in ["b", "c"] {
        add(format!("psd_{psd}.ln_power_gain"), "1", t.power_gain_percent * percent);
    }
    for element in ["xx", "xy", "yx", "yy"] {
        add(format!("steering.matrix_{element}"), "1", t.steering_matrix_percent * percent);
    }
    for axis in ["x", "y"] {
        add(format!("steering.origin_{axis}"), "m", t.steering_origin_mm * mm);
    }
    for frame in ["reference_frame", "mirror_frame"] {
        for axis in ["x", "y", "z"] {
            add(format!("{frame}.rotation_{axis}"), "rad", t.frame_mrad * mrad);
        }
        for axis in ["x", "y", "z"] {
            add(format!("{frame}.position_{axis}"), "m", t.frame_mm * mm);
        }
    }
    list
}

/// The step of a parameter for its difference quotient.
pub(super) fn step(parameter: usize) -> f64 {
    place::GROUPS.iter().find(|group| parameter < group.end).map_or(f64::NAN, |group| group.step)
}

impl Nominal {
    /// The head of the given parameters, its beam round, and its power gains.
    pub fn head(&self, theta: &[f64]) -> Head {
        let mut head = self.head.clone();
        for (i, psd) in head.psds.iter_mut().enumerate() {
            let p = &theta[place::PSD.at + 6 * i..];
            let axes = Mat3::from_columns(&[psd.x, psd.y, psd.z]);
            psd.origin += axes * Vec3::new(p[0], p[1], p[2]);
            let turned = axes * turn(&p[3..6]);
            [psd.x, psd.y, psd.z] = [0, 1, 2].map(|k| turned.column(k).into_owned());
        }
        for (i, normal) in head.facets.iter_mut().enumerate() {
            let p = &theta[place::FACET.at + 2 * i..];
            let zenith = Vec3::z() - *normal * normal.z;
            let up = zenith.try_normalize(1e-9).unwrap_or_else(Vec3::x);
            *normal = (*normal + up * p[0] + up.cross(&*normal) * p[1]).normalize();
        }
        let axes = turn_from_z(-head.beam_direction);
        let aside = axes * Vec3::new(theta[place::BEAM.at], theta[place::BEAM.at + 1], 0.0);
        head.beam_direction = (head.beam_direction + aside).normalize();
        head.beam_diameter *= theta[place::DIAMETER.at].exp();
        head
    }

    /// The steering matrix of the given parameters.
    pub fn steering_matrix(&self, theta: &[f64]) -> Matrix2<f64> {
        self.steering_matrix + Matrix2::from_row_slice(&theta[place::MATRIX.at..place::MATRIX.at + 4])
    }

    /// The steering origin of the given parameters, metres.
    pub fn steering_origin(&self, theta: &[f64]) -> Vector2<f64> {
        self.steering_origin + Vector2::new(theta[place::ORIGIN.at], theta[place::ORIGIN.at + 1])
    }

    /// Frame of the reference in the sensor's world, and mirror in the frame of the reference's table.
    pub fn frames(&self, theta: &[f64]) -> [Rigid; 2] {
        let part = |nominal: &Rigid, at: usize| {
            let p = &theta[at..at + 6];
            (turn(p) * nominal.rotation, Vec3::new(p[3], p[4], p[5]))
        };
        // The shift of the reference is along its own axes, as the pose in its frame: with a shift in the world's
        // axes, shift and rotation would multiply, and the steps of a fit would be too long.
        let (rotation, shift) = part(&self.stage, place::STAGE.at);
        let translation = rotation * (self.stage.rotation.transpose() * self.stage.translation + shift);
        let stage = Rigid { rotation, translation };
        let (rotation, shift) = part(&self.table, place::TABLE.at);
        [stage, Rigid { rotation, translation: self.table.translation + shift }]
    }

    /// The shape of the beam.
    pub fn ellipse(theta: &[f64]) -> Ellipse {
        Ellipse::new(theta[place::ELLIPSE.at], theta[place::ELLIPSE.at + 1])
    }

    /// Power gains relative to A.
    pub fn power_gains(theta: &[f64]) -> [f64; 3] {
        [1.0, theta[place::GAIN.at].exp(), theta[place::GAIN.at + 1].exp()]
    }

    /// The forward model of the given parameters.
    pub(super) fn instrument(&self, theta: &[f64]) -> Instrument {
        let [stage, table] = self.frames(theta);
        let ln_gains = [0.0, theta[place::GAIN.at], theta[place::GAIN.at + 1]];
        let steering = (self.steering_matrix(theta), self.steering_origin(theta));
        let frames = [stage.inverse(), table.inverse()];
        Instrument::new(&self.head(theta), Self::ellipse(theta), ln_gains, steering, frames)
    }
}

/// The rotation of a rotation vector.
fn turn(v: &[f64]) -> Mat3 {
    Rotation3::new(Vec3::new(v[0], v[1], v[2])).into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_groups_hold_all_parameters_in_the_order_of_their_names() {
        let all = parameters(&Tolerances::default());
        assert_eq!(all.len(), GEOMETRY);
        for (group, start) in place::GROUPS.into_iter().zip([
            "psd_a.",
            "facet_a.",
            "beam.direction",
            "beam.ln_diameter",
            "beam.ellipse",
            "psd_b.ln_power_gain",
            "steering.matrix",
            "steering.origin",
            "reference_frame.",
            "mirror_frame.",
        ]) {
            assert!(all[group.at].name.starts_with(start), "{group:?} {}", all[group.at].name);
            let geometric = all[group.at].unit != "1";
            assert_eq!(step(group.at), if geometric { 1e-5 } else { 1e-4 }, "{group:?}");
        }
    }
}
