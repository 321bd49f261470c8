//! What the loop knows of the mirror: where its apex is, and how fast it moves.

use trifacet_optics::{Optics, Pose};

use super::stage::read_back;
use super::tracking::Tracking;
use crate::centering::observation::BeamObservation;
use crate::centering::{LoopParams, Target, TimedPose};
use crate::signals::{PsdState, Sample};
use crate::steering::Xy;

/// Looks for the apex, sample by sample.
#[derive(Clone, Debug)]
pub struct ApexTracker {
    optics: Optics,
    /// The last pose that was told.
    pose: Pose,
    /// Where the apex is, seen across the beam, as far as is known.
    apex: Option<Xy>,
    /// It was once seen by all three PSDs.
    known: bool,
    tracking: Tracking,
    /// The tracking filter starts over after a longer pause.
    patience_s: f64,
}

impl ApexTracker {
    /// Knows nothing yet.
    pub fn new(optics: Optics, patience_s: f64) -> Self {
        let tracking = Tracking::default();
        Self { optics, pose: Pose::default(), apex: None, known: false, tracking, patience_s }
    }

    /// Standard deviation of the beam, metres.
    pub fn beam_sigma(&self) -> f64 {
        self.optics.sigma()
    }

    /// Whether the apex was once seen by all three PSDs.
    pub fn knows_apex(&self) -> bool {
        self.known
    }

    /// Velocity of the apex across the beam, metres per second.
    pub fn velocity(&self) -> Xy {
        self.tracking.velocity()
    }

    /// The velocity is to be found anew.
    pub fn interrupt(&mut self) {
        self.tracking.reset();
    }

    /// The beam is elsewhere than was thought, and so is the apex.
    pub fn forget(&mut self) {
        (self.apex, self.known) = (None, false);
        self.interrupt();
    }

    /// What the sample says, with the stage standing at `stage`. `pose` is the last valid one, if it is fresh.
    pub fn look(
        &mut self,
        sample: &Sample,
        stage: Xy,
        pose: Option<&TimedPose>,
        params: &LoopParams,
    ) -> BeamObservation {
        if let Some(told) = pose {
            self.pose = told.pose;
        }
        let all_lit = sample.psds.iter().all(|psd| *psd == PsdState::Good);
        let mirror = match (params.target, pose) {
            _ if !all_lit => self.pose, // the best there is
            (Target::Apex, Some(told)) => told.pose,
            // Nominal wedges: there equal powers are zero offset.
            (Target::Apex, None) | (Target::Balance, _) => Pose::default(),
        };
        let beam = params.map.beam(stage);
        let apex = self.apex.unwrap_or(self.optics.across(self.pose.t).into());
        let observation = BeamObservation::of(sample, beam, &mirror, apex, &self.optics);
        match observation {
            BeamObservation::Offset(offset) => {
                let apex = [0, 1].map(|i| beam[i] - offset[i]);
                (self.apex, self.known) = (Some(apex), true);
                self.track(sample, apex, pose, params.tracking_hz);
            }
            BeamObservation::Partial { apex, .. } => self.apex = Some(apex),
            BeamObservation::Dark | BeamObservation::Unclear(_) => {}
        }
        observation
    }

    /// Position of the apex for the tracking filter, by the quieter of two sources: readback less offset (0.1 um
    /// with good parts), or the solved pose of nine signals (1 um). The pose of eleven signals is as good as
    /// the former, and comes a sample later.
    fn track(&mut self, sample: &Sample, apex: Xy, pose: Option<&TimedPose>, bandwidth_hz: f64) {
        let (position, time) = match (read_back(sample), pose) {
            (Some(_), _) => (apex, sample.time),
            (None, Some(told)) => (self.optics.across(told.pose.t).into(), told.time),
            (None, None) => return,
        };
        if position.iter().all(|p| p.is_finite()) {
            self.tracking.update(position, time, bandwidth_hz, self.patience_s);
        }
    }
}
