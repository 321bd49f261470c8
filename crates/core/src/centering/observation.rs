//! What a sample says of the beam and the apex.

use trifacet_optics::{Model, Optics, Pose, Vec2};

use crate::signals::{PsdState, Sample};
use crate::steering::Xy;

/// A PSD is covered if it is dark although this fraction of the beam should fall on it.
const COVERED: f64 = 0.05;

/// What a sample says. Lengths in metres, across the beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BeamObservation {
    /// All PSDs see light: the offset of the beam from the apex, by the powers.
    Offset(Xy),
    /// Some do.
    Partial {
        /// Where the apex should be, as far as their spots show.
        apex: Xy,
        /// The beam may well be on the apex: a PSD is covered, or a channel is clipped.
        covered: bool,
        /// What is missing.
        cause: &'static str,
    },
    /// None does.
    Dark,
    /// Nothing can be said, for this reason.
    Unclear(&'static str),
}

impl BeamObservation {
    /// Looks at a sample, with the beam at `beam`. `pose` is that of the mirror, as far as it is known, and
    /// `apex` where its apex was when it was last seen.
    pub fn of(sample: &Sample, beam: Xy, pose: &Pose, apex: Xy, optics: &Optics) -> Self {
        let count = |state| sample.psds.iter().filter(|psd| **psd == state).count();
        match (count(PsdState::Low), count(PsdState::Clipped)) {
            (0, 0) => match optics.offset_of_powers(&sample.powers, pose) {
                Ok(offset) => BeamObservation::Offset(offset.into()),
                Err(_) => BeamObservation::Unclear("the powers give no offset"),
            },
            // Too much light, and no movement would help.
            (0, 3) => BeamObservation::Unclear("every PSD is clipped"),
            // One channel may be broken, or nearly all light fall on one PSD: that is three times what it gets at
            // the apex.
            (0, _) => BeamObservation::Partial { apex, covered: true, cause: "a channel is clipped" },
            (3, _) => BeamObservation::Dark,
            _ => {
                let cause = "a PSD sees too little light";
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

    /// Whether a PSD is dark that the beam should light, and the other spots are where they are with the beam
    /// on this apex.
    fn covered(sample: &Sample, beam: Xy, pose: &Pose, apex: Xy, optics: &Optics) -> bool {
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

    /// Each spot shows how far downhill from the apex the beam is; along the contour of its facet, where the
    /// apex was must do.
    fn apex_by_spots(sample: &Sample, beam: Xy, pose: &Pose, apex: Xy, optics: &Optics) -> Xy {
        let (beam, mut apex) = (Vec2::from(beam), Vec2::from(apex));
        for facet in (0..3).filter(|i| sample.psds[*i] == PsdState::Good) {
            let spot = [sample.spots[2 * facet], sample.spots[2 * facet + 1]];
            if let Some(glimpse) = optics.glimpse(facet, spot, pose) {
                let distance = (beam - apex).dot(&glimpse.downhill);
                apex += glimpse.downhill * (distance - glimpse.distance());
            }
        }
        apex.into()
    }
}
