//! What a sample says of the beam and the apex.

use crate::acquisition::{PsdState, Sample};
use crate::optics::{Optics, Pose, Vec2};
use crate::steering::Xy;

/// A PSD is covered if it is dark although this fraction of the beam should fall on it.
const COVERED: f64 = 0.05;

/// What a sample says. Lengths in metres, across the beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sight {
    /// All PSDs see light: the offset of the beam from the apex, by the powers.
    Offset(Xy),
    /// Some do.
    Some {
        /// Where the apex should be, as far as their spots show.
        apex: Xy,
        /// The beam should light a PSD that is dark.
        covered: bool,
    },
    /// None does.
    Dark,
    /// Nothing can be said, for this reason.
    Unclear(&'static str),
}

impl Sight {
    /// Looks at a sample, with the beam at `beam`. `pose` is that of the mirror, as far as it is known, and
    /// `apex` where its apex was when it was last seen.
    pub fn of(sample: &Sample, beam: Xy, pose: &Pose, apex: Xy, optics: &Optics) -> Self {
        let count = |state| sample.psds.iter().filter(|psd| **psd == state).count();
        match (count(PsdState::Low), count(PsdState::Clipped)) {
            (0, 0) => match optics.offset_of_powers(&sample.powers, pose) {
                Ok(offset) => Sight::Offset(offset.into()),
                Err(_) => Sight::Unclear("the powers give no offset"),
            },
            (0, _) => Sight::Unclear("a channel is clipped"),
            (3, _) => Sight::Dark,
            // All the light on one PSD is three times what it gets at the apex: that may well be clipped,
            // and is light.
            _ => Self::of_some(sample, beam, pose, apex, optics),
        }
    }

    /// Each spot shows how far downhill from the apex the beam is; along the contour of its facet, where the
    /// apex was must do.
    fn of_some(sample: &Sample, beam: Xy, pose: &Pose, apex: Xy, optics: &Optics) -> Self {
        let (beam, mut apex) = (Vec2::from(beam), Vec2::from(apex));
        for facet in (0..3).filter(|i| sample.psds[*i] == PsdState::Good) {
            let spot = [sample.spots[2 * facet], sample.spots[2 * facet + 1]];
            if let Some(glimpse) = optics.glimpse(facet, spot, pose) {
                let distance = (beam - apex).dot(&glimpse.downhill);
                apex += glimpse.downhill * (distance - glimpse.distance());
            }
        }
        let expected = optics.fractions(beam - apex, pose);
        let covered = (0..3).any(|i| sample.psds[i] == PsdState::Low && expected[i] > COVERED);
        Sight::Some { apex: apex.into(), covered }
    }
}
