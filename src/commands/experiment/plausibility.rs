//! Plausibility checks of references that the operator types.

use trifacet::experiment::observation::Observation;
use trifacet::experiment::reading::Reading;
use trifacet::experiment::{place, three};

use super::steps::Step;

/// Largest distance of a reference from its target, in addition to the range of the axis, metres or
/// radians. The zero of an interferometer is arbitrary.
const MARGIN: f64 = 100e-6;
/// Threshold in standard uncertainties of the difference of two means.
const SURE: f64 = 5.0;

/// Why a reference is not plausible for this point. `None`: it is plausible.
pub(super) fn implausible(step: &Step, steps: &[Step], reference: f64, before: &[Reading]) -> Option<String> {
    let targets = || steps.iter().filter(|s| s.axis == step.axis).map(|s| s.target);
    let range = targets().fold(f64::NEG_INFINITY, f64::max) - targets().fold(f64::INFINITY, f64::min);
    let (unit, typed) = (step.axis.micro_unit(), place(reference * 1e6));
    if (reference - step.target).abs() > range + MARGIN {
        let most = three((range + MARGIN) * 1e6);
        let target = place(step.target * 1e6);
        return Some(format!(
            "{typed} {unit} is more than {most} {unit} from the target {target} {unit}: not accepted"
        ));
    }
    let same = last(step, before).next()?.moved?.1 == reference;
    same.then(|| format!("{typed} {unit} is the reference of the previous point: the mirror must move"))
}

/// A warning if sensor and reference moved in opposite directions.
pub(super) fn opposite(
    step: &Step,
    reference: f64,
    looks: &[Observation],
    before: &[Reading],
) -> Option<String> {
    let i = step.axis as usize;
    let went = reference - last(step, before).next()?.moved?.1;
    let [now, then] = [mean(i, looks.iter()), mean(i, last(step, before).map(|r| &r.look))];
    let moved = (now.0 - then.0) * went.signum();
    (moved < -SURE * now.1.hypot(then.1)).then(|| {
        format!(
            "the sensor moved by {} {unit}, the reference by {} {unit}: check the signs (b repeats the previous point)",
            place((now.0 - then.0) * 1e6),
            place(went * 1e6),
            unit = step.axis.micro_unit(),
        )
    })
}

/// The readings of the previous point on this axis.
fn last<'r>(step: &Step, before: &'r [Reading]) -> impl Iterator<Item = &'r Reading> + use<'r> {
    let (axis, point) = (step.axis, step.point);
    before.iter().filter(move |r| r.moved.is_some_and(|(a, _)| a == axis) && r.point + 1 == point)
}

/// The mean of one axis and its standard uncertainty, metres or radians.
fn mean<'l>(axis: usize, looks: impl Iterator<Item = &'l Observation>) -> (f64, f64) {
    let (mut n, mut sum, mut square) = (0.0, 0.0, 0.0);
    for look in looks {
        n += 1.0;
        sum += look.pose[axis];
        square += f64::from(look.sigmas[axis]).powi(2);
    }
    (sum / n, square.sqrt() / n)
}

#[cfg(test)]
mod tests {
    use trifacet::config::Axis;
    use trifacet::experiment::reading::Part;
    use trifacet_wire::Status;

    use super::*;

    fn look(x: f64) -> Observation {
        let status = Status::POSE_VALID;
        Observation { time_ns: 0, pose: [x; 6], sigmas: [1e-6; 6], averaged: 1, config: 1, status }
    }

    #[test]
    fn implausible_readings_are_reported() {
        let step = |point: u32| Step { axis: Axis::Tx, point, of: 3, target: 1e-6 * f64::from(point) };
        let steps = [step(1), step(2), step(3)];
        let readings: Vec<Reading> = (1..=4)
            .map(|number| Reading {
                part: Part::Table2,
                moved: Some((Axis::Tx, 5e-6)),
                point: 1,
                number,
                look: look(0.0),
            })
            .collect();
        let typed = |reference| implausible(&steps[1], &steps, reference, &readings).unwrap_or_default();
        assert_eq!((typed(103e-6), typed(-99e-6)), (String::new(), String::new()));
        assert!(typed(105e-6).contains("is more than 102 um from the target +2.00 um"), "{}", typed(105e-6));
        assert!(typed(1.0).len() < 100 && typed(1e300).len() < 100);
        assert!(typed(5e-6).contains("the reference of the previous point"));
        assert_eq!(implausible(&steps[0], &steps, 5e-6, &readings), None);
        // With four readings, five standard uncertainties of the difference are 3.5 um.
        let went = |reference, x| opposite(&steps[1], reference, &[look(x); 4], &readings);
        assert!(
            went(4e-6, 4e-6).unwrap().contains("the sensor moved by +4.00 um, the reference by -1.00 um")
        );
        assert!(went(6e-6, -4e-6).is_some());
        assert_eq!((went(4e-6, 3e-6), went(6e-6, 4e-6)), (None, None));
    }
}
