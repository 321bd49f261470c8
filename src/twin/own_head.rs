//! The true head of the twin, apart from what the estimator believes: the configured one with random errors.

use std::array::from_fn;

use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use trifacet_optics::{Ellipse, FACETS, Head, Mat3, Optics, Pose, Psd, Rigid, Vec2, Vec3};

use super::distortion::{Distortion, Ripple};
use super::{TwinError, random};
use crate::config::{Config, TwinPsd, TwinTolerances};

/// A head of its own.
#[derive(Clone, Debug)]
pub struct OwnHead {
    /// Geometry and beam.
    pub head: Head,
    /// Shape of the beam.
    pub ellipse: Ellipse,
    /// The errors of PSDs A, B, C.
    pub psds: [PsdErrors; 3],
    /// The frames of the stage.
    pub stage: StageFrames,
}

/// Errors of a PSD with its amplifier.
#[derive(Clone, Debug)]
pub struct PsdErrors {
    /// Factors by which u, v and power read too large.
    pub gain: [f64; 3],
    /// Distortion of the position, before the gain.
    pub distortion: Distortion,
}

/// The stage that carries the mirror.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageFrames {
    /// The axes of the stage in the sensor's world.
    world: Rigid,
    /// The frame of the mirror in that of the table.
    mirror: Rigid,
}

impl StageFrames {
    /// A stage whose axes and origin are those of the head and of the mirror.
    pub fn identity() -> Self {
        Self { world: Rigid::identity(), mirror: Rigid::identity() }
    }

    /// The pose of the mirror in the sensor's world, from the pose of the table in the axes of the stage.
    pub fn mirror(&self, table: &Pose) -> Pose {
        if *self == Self::identity() {
            *table
        } else {
            (&(self.world * Rigid::from(table) * self.mirror)).into()
        }
    }
}

impl OwnHead {
    /// The head of the configuration; `None` if the twin has none of its own.
    ///
    /// # Errors
    /// The geometry is not that of a head, or at rest the light does not reach all PSDs.
    pub fn of(config: &Config) -> Result<Option<Self>, TwinError> {
        if !config.twin.has_own_head() {
            return Ok(None);
        }
        let head = config.twin_geometry().build().map_err(|e| TwinError::new("twin.head", e.to_string()))?;
        let twin = &config.twin;
        let psds = twin.psd.clone().unwrap_or_default();
        let half_sizes = head.psds.map(|psd| psd.half_size);
        let stage = twin.stage.clone().unwrap_or_default();
        let (base, tool) = (stage.base.build(), stage.tool.build());
        let mut own = Self {
            head,
            ellipse: Ellipse::new(0.0, 0.0),
            psds: from_fn(|i| PsdErrors::new(psds.each()[i], half_sizes[i], twin.bow_um * 1e-6)),
            stage: StageFrames { world: base.inverse(), mirror: tool.inverse() },
        };
        let mut ellipse = twin.beam.clone().unwrap_or_default().ellipse;
        if let Some(tolerances) = &twin.tolerances {
            own.spoil(tolerances, &mut ellipse);
        }
        own.ellipse = Ellipse::new(ellipse[0], ellipse[1]);
        own.head = own.head.checked().map_err(|e| TwinError::new("twin.tolerances", e.to_string()))?;
        own.lit()?;
        Ok(Some(own))
    }

    /// Applies random errors. Each kind has a random stream of its own, so that a change of one tolerance changes
    /// nothing else.
    fn spoil(&mut self, tolerances: &TwinTolerances, ellipse: &mut [f64; 2]) {
        let stream = |stream: u64| random(tolerances.seed, 1000 + stream);
        let mut geometry = stream(0);
        for (psd, normal) in self.head.psds.iter_mut().zip(&mut self.head.facets) {
            shift_and_turn(psd, tolerances, &mut geometry);
            *normal = turned_facet(normal, tolerances.facet_turn_mrad * 1e-3, &mut geometry);
        }
        let mut beam = stream(1);
        let tilt = vector(tolerances.beam_tilt_mrad * 1e-3, &mut beam);
        self.head.beam_direction += tilt.cross(&self.head.beam_direction);
        self.head.beam_diameter *= (tolerances.beam_diameter_percent * 1e-2 * clipped(&mut beam)).exp();
        for parameter in ellipse {
            *parameter += tolerances.ellipticity_percent * 1e-2 * clipped(&mut beam);
        }
        let mut gains = stream(2);
        for (i, psd) in self.psds.iter_mut().enumerate() {
            let percent = tolerances.psd_gain_percent;
            let power = if i == 0 { 0.0 } else { tolerances.power_gain_percent };
            for (gain, percent) in psd.gain.iter_mut().zip([percent, percent, power]) {
                *gain *= (percent * 1e-2 * clipped(&mut gains)).exp();
            }
        }
        let mut maps = stream(3);
        for psd in &mut self.psds {
            spoil_map(&mut psd.distortion, tolerances, &mut maps);
        }
        self.stage = self.stage.turned(tolerances, &mut stream(4));
    }

    /// Checks that the light reaches all PSDs while the mirror is at rest, with the beam on the apex.
    fn lit(&self) -> Result<(), TwinError> {
        let rest = self.stage.mirror(&Pose::default());
        let (spots, _) = Optics::new(&self.head).trace_elliptical(&self.ellipse, &rest, Vec2::zeros());
        for (facet, spot) in FACETS.iter().zip(spots) {
            spot.map_err(|error| {
                let reason = format!(
                    "with the mirror at rest the light of facet {facet} does not reach its PSD: {error}; allowed is \
                     a head whose light does, such as one of another twin.tolerances.seed or of smaller tolerances"
                );
                TwinError::new("twin.head", reason)
            })?;
        }
        Ok(())
    }
}

impl PsdErrors {
    fn new(config: &TwinPsd, half_size: f64, bow: f64) -> Self {
        let distortion = Distortion {
            half_size,
            bow: bow + config.bow_um * 1e-6,
            asymmetry: config.asymmetry_um.map(|um| um * 1e-6),
            ripple: [Ripple::default(), Ripple::default()],
        };
        Self { gain: config.gain, distortion }
    }
}

impl StageFrames {
    /// Axes that are turned against those of the head, and a lever arm between table and apex. The mirror has been
    /// aligned: at rest, the apex is where it would be without both, and the mirror is not turned.
    fn turned(self, tolerances: &TwinTolerances, rng: &mut impl Rng) -> Self {
        let turn = rotation(vector(tolerances.stage_turn_mrad * 1e-3, rng));
        let lever = vector(tolerances.stage_lever_mm * 1e-3, rng);
        let axes = Rigid { rotation: turn, translation: -(turn * lever) };
        let back = Rigid { rotation: turn.transpose(), translation: lever };
        Self { world: self.world * axes, mirror: back * self.mirror }
    }
}

fn shift_and_turn(psd: &mut Psd, tolerances: &TwinTolerances, rng: &mut impl Rng) {
    psd.origin += vector(tolerances.psd_shift_mm * 1e-3, rng);
    let turn = rotation(vector(tolerances.psd_turn_mrad * 1e-3, rng));
    (psd.x, psd.y, psd.z) = (turn * psd.x, turn * psd.y, turn * psd.z);
}

/// The normal turned towards the zenith and about it.
fn turned_facet(normal: &Vec3, sigma: f64, rng: &mut impl Rng) -> Vec3 {
    let side = Vec3::z().cross(normal).normalize();
    rotation(side * -(sigma * clipped(rng)) + Vec3::z() * (sigma * clipped(rng))) * normal
}

fn spoil_map(map: &mut Distortion, tolerances: &TwinTolerances, rng: &mut impl Rng) {
    let [least, largest] = tolerances.psd_bow_um;
    map.bow += (least + (largest - least) * rng.random::<f64>()) * 1e-6;
    for term in &mut map.asymmetry {
        *term += tolerances.psd_asymmetry_um * 1e-6 * clipped(rng);
    }
    let waves = tolerances.psd_ripple_mm.map(|mm| mm * 1e-3);
    map.ripple = from_fn(|_| Ripple::new(tolerances.psd_ripple_um * 1e-6, waves, rng));
}

/// A normal random number within two standard deviations.
fn clipped(rng: &mut impl Rng) -> f64 {
    rng.sample::<f64, _>(StandardNormal).clamp(-2.0, 2.0)
}

fn vector(sigma: f64, rng: &mut impl Rng) -> Vec3 {
    Vec3::from_fn(|_, _| sigma * clipped(rng))
}

fn rotation(vector: Vec3) -> Mat3 {
    nalgebra::Rotation3::new(vector).into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(change: impl FnOnce(&mut TwinTolerances)) -> Config {
        let mut config = Config::default();
        let mut tolerances = TwinTolerances::default();
        change(&mut tolerances);
        config.twin.tolerances = Some(tolerances);
        config
    }

    fn head(seed: u64) -> OwnHead {
        OwnHead::of(&config(|t| t.seed = seed)).unwrap().unwrap()
    }

    #[test]
    fn the_errors_have_their_sizes_and_each_seed_is_another_head() {
        let nominal = Head::default();
        let (mut shift, mut turn, mut facet, mut gain) = (0.0, 0.0, 0.0, 0.0);
        for own in (0..200).map(head) {
            for i in 0..3 {
                shift += (own.head.psds[i].origin - nominal.psds[i].origin).norm_squared() / (600.0 * 3.0);
                turn += (own.head.psds[i].z - nominal.psds[i].z).norm_squared() / (600.0 * 2.0);
                facet += (own.head.facets[i] - nominal.facets[i]).norm_squared() / (600.0 * 1.5);
                gain += (own.psds[i].gain[0] - 1.0).powi(2) / 600.0;
            }
        }
        // Clipped at two deviations, a normal distribution has a deviation of 0.96.
        for (what, square, sigma) in
            [("shift", shift, 5e-4_f64), ("turn", turn, 5e-3), ("facet", facet, 5e-4), ("gain", gain, 5e-3)]
        {
            let ratio = square.sqrt() / sigma;
            assert!((0.88..1.04).contains(&ratio), "{what}: {ratio}");
        }
    }

    #[test]
    fn one_tolerance_does_not_change_the_other_errors() {
        let with = head(3);
        let without = OwnHead::of(&config(|t| (t.seed, t.psd_gain_percent) = (3, 0.0))).unwrap().unwrap();
        assert_eq!(with.head, without.head);
        assert_eq!(without.psds[0].gain, [1.0; 3]);
        assert_ne!(with.psds[0].gain, without.psds[0].gain);
        let at = [2e-3, -1e-3];
        assert_eq!(with.psds[2].distortion.reading(at), without.psds[2].distortion.reading(at));
    }

    #[test]
    fn a_turned_stage_with_a_lever_leaves_the_mirror_at_rest_where_it_was() {
        let own =
            OwnHead::of(&config(|t| (t.stage_turn_mrad, t.stage_lever_mm) = (20.0, 5.0))).unwrap().unwrap();
        let near = |a: &Pose, b: &Pose, by: f64| {
            a.to_array().iter().zip(b.to_array()).all(|(a, b)| (a - b).abs() <= by)
        };
        assert!(near(&own.stage.mirror(&Pose::default()), &Pose::default(), 1e-15));
        let moved = Pose::from_array([1e-3, 0.0, 0.0, 0.0, 0.0, 1e-2]);
        let mirror = own.stage.mirror(&moved);
        assert!(!near(&mirror, &moved, 1e-5), "{mirror:?}");
        assert!(near(&mirror, &moved, 3e-4), "{mirror:?}");
    }

    #[test]
    fn a_head_whose_light_misses_a_psd_is_refused_with_the_reason() {
        let mut config = config(|t| t.facet_turn_mrad = 20.0);
        let refused = (0..40).find_map(|seed| {
            config.twin.tolerances.as_mut().unwrap().seed = seed;
            OwnHead::of(&config).err()
        });
        let error = refused.unwrap().to_string();
        assert!(error.contains("twin.head: with the mirror at rest") && error.contains("seed"), "{error}");
    }
}
