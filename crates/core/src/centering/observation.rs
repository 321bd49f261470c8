//! What a sample shows of the beam and the apex.

use trifacet_optics::{Model, Optics, Pose, Vec2};

use super::lock::LockCause;
use crate::signals::{PsdState, Sample};
use crate::steering::{BeamOffset, BeamPoint};

/// A PSD counts as covered if it is dark although this fraction of the beam should reach it.
const COVERED: f64 = 0.05;

/// What a sample shows. Lengths in metres, across the beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BeamObservation {
    /// All PSDs see light: the offset of the beam from the apex, from the powers.
    Offset(BeamOffset),
    /// One or two PSDs see light, or a channel is clipped.
    Partial {
        /// Position of the apex, as far as the spots show it.
        apex: BeamPoint,
        /// The beam may be on the apex although light is missing: a PSD is covered, or a channel is clipped.
        covered: bool,
        /// The reason why the observation is incomplete.
        cause: LockCause,
    },
    /// No PSD sees light.
    Dark,
    /// The sample gives no information, for this reason.
    Unclear(LockCause),
}

impl BeamObservation {
    /// Evaluates a sample, with the beam at `beam`. `pose` is the best known pose of the mirror, `apex` the
    /// last known position of its apex.
    pub fn of(sample: &Sample, beam: BeamPoint, pose: &Pose, apex: BeamPoint, optics: &Optics) -> Self {
        if sample.psds.contains(&PsdState::Frozen) {
            return BeamObservation::Unclear(LockCause::Frozen);
        }
        let count = |state| sample.psds.iter().filter(|psd| **psd == state).count();
        match (count(PsdState::Low), count(PsdState::Clipped)) {
            (0, 0) => match optics.offset_of_powers(&sample.powers, pose) {
                Ok(offset) => BeamObservation::Offset(offset.into()),
                Err(_) => BeamObservation::Unclear(LockCause::NoOffset),
            },
            // Too much light; no move of the stage would help.
            (0, 3) => BeamObservation::Unclear(LockCause::AllClipped),
            // Either one channel is broken, or nearly all light falls on one PSD, which then receives three
            // times the power that it receives with the beam on the apex.
            (0, _) => BeamObservation::Partial { apex, covered: true, cause: LockCause::Clipped },
            (3, _) => BeamObservation::Dark,
            _ => {
                let cause = LockCause::LittleLight;
                if Self::covered(sample, beam, pose, apex, optics) {
                    return BeamObservation::Partial { apex, covered: true, cause };
                }
                BeamObservation::Partial {
                    apex: Self::apex_by_spots(sample, beam, pose, apex, optics),
                    covered: false,
                    cause,
                }
            }
        }
    }

    /// Whether a PSD is dark that the beam should light, while the other spots are where they belong with the
    /// beam at this offset from the apex.
    fn covered(sample: &Sample, beam: BeamPoint, pose: &Pose, apex: BeamPoint, optics: &Optics) -> bool {
        let offset = Vec2::from(beam) - Vec2::from(apex);
        let (spots, fractions) = optics.trace_each(Model::Gaussian, pose, offset);
        let as_expected = |i: usize| match (sample.psds[i], spots[i]) {
            (PsdState::Good, Ok([u, v])) => {
                (sample.spots[2 * i] - u).hypot(sample.spots[2 * i + 1] - v) < optics.sigma()
            }
            (PsdState::Good, Err(_)) => false,
            _ => true,
        };
        (0..3).all(as_expected) && (0..3).any(|i| sample.psds[i] == PsdState::Low && fractions[i] > COVERED)
    }

    /// Each spot gives the distance of the beam from the apex along the steepest descent of its facet. Along
    /// the contour lines of the facet, the last known position of the apex is used.
    fn apex_by_spots(
        sample: &Sample,
        beam: BeamPoint,
        pose: &Pose,
        apex: BeamPoint,
        optics: &Optics,
    ) -> BeamPoint {
        let (beam, mut apex) = (Vec2::from(beam), Vec2::from(apex));
        for facet in (0..3).filter(|i| sample.psds[*i] == PsdState::Good) {
            let spot = [sample.spots[2 * facet], sample.spots[2 * facet + 1]];
            if let Some(facet_offset) = optics.facet_offset(facet, spot, pose) {
                let distance = (beam - apex).dot(&facet_offset.downhill);
                apex += facet_offset.downhill * (distance - facet_offset.distance());
            }
        }
        apex.into()
    }
}
