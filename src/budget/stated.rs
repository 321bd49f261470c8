//! The systematic part of the frames' uncertainty that the configuration states: the budget without the noise of the
//! pose and without the calibration.

use nalgebra::{Matrix6, Vector6};
use trifacet_budget::Evaluation;
use trifacet_core::estimation::by_pose::TRIANGLE;
use trifacet_optics::quadratic::Quadratic;
use trifacet_optics::{Pose, Rigid};

use super::assessment::slope;
use super::components::Components;
use super::instrument::Instrument;
use super::quantity::{Effect, Moment};
use crate::config::{Config, UncertaintyConfig};

/// Steps of the quadratic function, metres and radians. The smaller ones are for a head that cannot reach the larger.
const STEPS: [[f64; 2]; 3] = [[1e-3, 5e-3], [0.25e-3, 1e-3], [0.05e-3, 0.2e-3]];

/// The covariance as a function of the pose relative to the tare: lower triangle by rows, metres and radians. `None` if
/// nothing is stated, which is so without a calibration (`table`: that of its reference, in the frame of the mirror) as long as no key of `[uncertainty]` without default is set.
pub fn stated(config: &Config, table: Option<&Rigid>) -> Option<Quadratic> {
    if table.is_none() && !states_anything(&config.uncertainty) {
        return None;
    }
    let instrument =
        Instrument::new(config).ok()?.calibrated_at(table.copied().unwrap_or_else(Rigid::identity));
    let tared = instrument.tared();
    let components = Components::new(config, 1, table);
    let inputs: Vec<_> = components
        .groups
        .iter()
        .flat_map(|group| &group.inputs)
        .filter(|(input, effect)| match effect {
            Effect::Spot(Moment::Pose, _) | Effect::Power(Moment::Pose, _) => {
                input.evaluation == Evaluation::B
            }
            // Without a tare, poses are relative to the zero of the calibration.
            Effect::Spot(Moment::Tare, _)
            | Effect::Power(Moment::Tare, _)
            | Effect::Offset(Moment::Tare, _) => tared,
            Effect::Pose(_) => false, // the same at every pose, see `Settings::systematic`
            _ => true,
        })
        .map(|(input, effect)| (input.std, *effect))
        .collect();
    let covariance = |pose: [f64; 6]| {
        let measurement = instrument.measure(&Pose::from_array(pose)).ok()?;
        let mut sum = Matrix6::zeros();
        for (std, effect) in &inputs {
            let effect = Vector6::from(slope(&measurement, *effect, *std).ok()?) * *std;
            sum += effect * effect.transpose();
        }
        let triangle: Vec<f64> = (0..6).flat_map(|i| (0..=i).map(move |k| sum[(i, k)])).collect();
        (triangle.len() == TRIANGLE).then_some(triangle)
    };
    let found = STEPS.into_iter().find_map(|steps| Quadratic::new(steps, covariance));
    if found.is_none() {
        tracing::warn!(
            "the frames do not include what [uncertainty] states: the sensor cannot measure the tare pose"
        );
    }
    found
}

/// Whether a key without default is set.
fn states_anything(stated: &UncertaintyConfig) -> bool {
    let keys = [
        stated.temperature_range_k,
        stated.pointing_urad,
        stated.beam_offset_um,
        stated.reference_scale_ppm,
        stated.reference_angle_ppm,
        stated.reference_squareness_urad,
        stated.lever_arm_um,
        stated.dark_mv,
    ];
    keys.iter().any(Option::is_some)
}
