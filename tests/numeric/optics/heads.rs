//! Sensor heads for the tests, and random states of their mirrors.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, TAU};

use nalgebra::{Rotation3, Unit};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use trifacet_optics::{
    Estimator, Head, Model, Optics, Pose, Psd, Reading, Signals, Solution, TraceError, Vec2, Vec3,
};

/// The head of the paper.
pub fn nominal() -> Head {
    Head::nominal(0.25, 0.013, FRAC_PI_4, 0.46e-3).unwrap()
}

/// A head with its PSDs on the sub-beams of a mirror at rest.
struct Build {
    /// Inclination of each facet to the base, degrees.
    inclination: [f64; 3],
    /// Azimuth of each facet relative to 0, 120 and -120 degrees, degrees.
    azimuth: [f64; 3],
    /// Direction of the light; is normalised.
    beam: [f64; 3],
    diameter: f64,
    /// Distance from the apex to each PSD, metres.
    distance: [f64; 3],
    /// Tilt of each PSD about its v-axis and about its u-axis, from the orientation that faces the light,
    /// degrees.
    tilt: [[f64; 2]; 3],
    /// Rotation of each PSD about its normal, degrees.
    roll: [f64; 3],
}

const PLAIN: Build = Build {
    inclination: [45.0; 3],
    azimuth: [0.0; 3],
    beam: [0.0, 0.0, -1.0],
    diameter: 0.46e-3,
    distance: [0.25; 3],
    tilt: [[0.0; 2]; 3],
    roll: [0.0; 3],
};

impl Build {
    fn head(&self) -> Head {
        let light = Vec3::from(self.beam).normalize();
        let normal = |i: usize| {
            let azimuth = TAU / 3.0 * [0.0, 1.0, -1.0][i] + self.azimuth[i].to_radians();
            let (sin, cos) = self.inclination[i].to_radians().sin_cos();
            Vec3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos)
        };
        let psd = |i: usize| {
            let n = normal(i);
            let reflected = light - n * (2.0 * n.dot(&light));
            let square = Psd::facing(reflected * self.distance[i], -reflected, Vec3::z(), 0.013);
            let about = |axis: Vec3, deg: f64| {
                Rotation3::from_axis_angle(&Unit::new_normalize(axis), deg.to_radians())
            };
            let turn = about(square.z, self.tilt[i][0])
                * about(square.y, self.tilt[i][1])
                * about(square.x, self.roll[i]);
            Psd { x: turn * square.x, y: turn * square.y, z: turn * square.z, ..square }
        };
        let head = Head {
            psds: [0, 1, 2].map(psd),
            facets: [0, 1, 2].map(normal),
            beam_direction: light,
            beam_diameter: self.diameter,
        };
        head.checked().unwrap()
    }
}

/// The nominal head, and heads that differ from it in each parameter.
pub fn all() -> Vec<(&'static str, Head)> {
    let tilt = [[12.0, -7.0], [-20.0, 4.0], [3.0, 15.0]];
    let (inclination, azimuth) = ([44.0, 46.5, 45.3], [2.0, -1.5, 0.7]);
    let oblique = [0.12, -0.2, -1.0];
    vec![
        ("nominal", nominal()),
        ("near, thin beam", Head::nominal(0.18, 0.013, FRAC_PI_4, 0.2e-3).unwrap()),
        ("far, wide beam", Head::nominal(0.4, 0.013, FRAC_PI_4, 1e-3).unwrap()),
        ("tilted PSDs", Build { tilt, ..PLAIN }.head()),
        ("one PSD rolled by 90 degrees", Build { roll: [0.0, 90.0, 0.0], ..PLAIN }.head()),
        ("all PSDs rolled", Build { roll: [90.0, -90.0, 30.0], ..PLAIN }.head()),
        ("facets off 45 degrees", Build { inclination, azimuth, ..PLAIN }.head()),
        ("flat mirror", Build { inclination: [30.0; 3], ..PLAIN }.head()),
        ("oblique beam", Build { beam: oblique, ..PLAIN }.head()),
        (
            "everything at once",
            Build {
                inclination,
                azimuth,
                beam: oblique,
                diameter: 0.6e-3,
                distance: [0.22, 0.31, 0.27],
                tilt,
                roll: [FRAC_PI_2.to_degrees(), 17.0, -40.0],
            }
            .head(),
        ),
    ]
}

/// Random states of the mirror from a fixed seed.
pub struct Draw(pub Pcg64Mcg);

impl Draw {
    pub fn new(seed: u64) -> Self {
        Self(Pcg64Mcg::seed_from_u64(seed))
    }

    pub fn within(&mut self, limit: f64) -> f64 {
        self.0.random_range(-limit..=limit)
    }

    pub fn normal(&mut self, deviation: f64) -> f64 {
        deviation * self.0.sample::<f64, _>(StandardNormal)
    }

    /// t within 5 mm; roll, pitch, yaw with standard deviations of 13, 13, 26 mrad; all multiplied by
    /// `scale`.
    pub fn pose(&mut self, scale: f64) -> Pose {
        let t = [(); 3].map(|()| self.within(5e-3 * scale));
        let [roll, pitch, yaw] = [13e-3, 13e-3, 26e-3].map(|deviation| self.normal(deviation * scale));
        Pose { t: t.into(), roll, pitch, yaw }
    }

    /// An offset of this length in any direction.
    pub fn direction(&mut self, length: f64) -> Vec2 {
        let angle = self.within(TAU / 2.0);
        Vec2::new(angle.cos(), angle.sin()) * length
    }

    /// A state with all spots on the PSDs; offsets within the limit in x and y.
    pub fn state(&mut self, optics: &Optics, model: Model, scale: f64, offset: f64) -> State {
        loop {
            let pose = self.pose(scale);
            let offset = Vec2::new(self.within(offset), self.within(offset));
            if let Ok(reading) = optics.trace(model, &pose, offset) {
                return State { pose, offset, signals: signals(&reading) };
            }
        }
    }
}

/// A pose of the mirror, a beam offset, and the signals of the PSDs.
#[derive(Clone, Copy, Debug)]
pub struct State {
    pub pose: Pose,
    pub offset: Vec2,
    pub signals: Signals,
}

impl State {
    /// The error of a solution, metres or radians, including the offset.
    pub fn error(&self, solution: &Solution) -> f64 {
        let pose = self.pose.to_array().into_iter().zip(solution.pose.to_array());
        let worst = pose.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        worst.max((self.offset - solution.offset).amax())
    }
}

pub fn signals(reading: &Reading) -> Signals {
    Signals { spots: reading.spots, powers: reading.powers }
}

/// The residuals of a solution: spots in metres, powers as fractions of the beam.
pub fn misfit(
    estimator: &Estimator,
    solution: &Solution,
    signals: &Signals,
) -> Result<(f64, f64), TraceError> {
    let reading = estimator.optics().trace(estimator.model(), &solution.pose, solution.offset)?;
    let far = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let total: f64 = signals.powers.iter().sum();
    let powers = match estimator.model() {
        Model::Ray => 0.0,
        Model::Gaussian => far(&reading.powers, &signals.powers.map(|p| p / total)),
    };
    Ok((far(&reading.spots, &signals.spots), powers))
}
