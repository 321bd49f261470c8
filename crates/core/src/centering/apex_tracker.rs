//! Position and velocity of the apex, from samples and poses.

use trifacet_optics::{Optics, Pose};

use super::stage::read_back;
use super::tracking::Tracking;
use crate::centering::observation::BeamObservation;
use crate::centering::{LoopParams, Target, TimedPose};
use crate::signals::{PsdState, Sample};
use crate::steering::{BeamOffset, BeamPoint, StagePosition};

/// Tracks the apex, sample by sample.
#[derive(Clone, Debug)]
pub struct ApexTracker {
    optics: Optics,
    /// The last valid pose.
    pose: Pose,
    /// Last known position of the apex across the beam, metres.
    apex: Option<BeamPoint>,
    /// All three PSDs have seen the apex at least once.
    known: bool,
    tracking: Tracking,
    /// The tracking filter starts again after a longer pause.
    patience_s: f64,
}

impl ApexTracker {
    /// A tracker without any observation.
    pub fn new(optics: Optics, patience_s: f64) -> Self {
        let tracking = Tracking::default();
        Self { optics, pose: Pose::default(), apex: None, known: false, tracking, patience_s }
    }

    /// Standard deviation of the Gaussian beam profile (a quarter of the 1/e^2 diameter), metres.
    pub fn beam_sigma(&self) -> f64 {
        self.optics.sigma()
    }

    /// Whether all three PSDs have seen the apex at least once.
    pub fn knows_apex(&self) -> bool {
        self.known
    }

    /// Velocity of the apex across the beam, metres per second.
    pub fn velocity(&self) -> BeamOffset {
        self.tracking.velocity()
    }

    /// Resets the velocity.
    pub fn interrupt(&mut self) {
        self.tracking.reset();
    }

    /// Discards the position of the apex: the map from stage to beam has changed.
    pub fn forget(&mut self) {
        (self.apex, self.known) = (None, false);
        self.interrupt();
    }

    /// Evaluates a sample, with the stage at `stage`. `pose` is the last valid pose, if it is recent.
    pub fn look(
        &mut self,
        sample: &Sample,
        stage: StagePosition,
        pose: Option<&TimedPose>,
        params: &LoopParams,
    ) -> BeamObservation {
        if let Some(reported) = pose {
            self.pose = reported.pose;
        }
        let all_lit = sample.psds.iter().all(|psd| *psd == PsdState::Good);
        let mirror = match (params.target, pose) {
            _ if !all_lit => self.pose, // the best known pose
            (Target::Apex, Some(reported)) => reported.pose,
            // With nominal wedges, equal powers mean zero offset.
            (Target::Apex, None) | (Target::Balance, _) => Pose::default(),
        };
        let beam = params.map.beam(stage);
        let apex = self.apex.unwrap_or(self.optics.across(self.pose.t).into());
        let observation = BeamObservation::of(sample, beam, &mirror, apex, &self.optics);
        match observation {
            BeamObservation::Offset(offset) => {
                let apex = BeamPoint([0, 1].map(|i| beam[i] - offset[i]));
                (self.apex, self.known) = (Some(apex), true);
                self.track(sample, apex, pose, params.tracking_hz);
            }
            BeamObservation::Partial { apex, .. } => self.apex = Some(apex),
            BeamObservation::Dark | BeamObservation::Unclear(_) => {}
        }
        observation
    }

    /// Passes the position of the apex to the tracking filter, from the better of two sources: readback minus
    /// offset (0.1 um with good parts), or the solved pose of nine signals (1 um). The pose of eleven signals
    /// has as little noise as readback minus offset, but is available one sample later.
    fn track(&mut self, sample: &Sample, apex: BeamPoint, pose: Option<&TimedPose>, bandwidth_hz: f64) {
        let (position, time) = match (read_back(sample), pose) {
            (Some(_), _) => (apex, sample.time),
            (None, Some(reported)) => (self.optics.across(reported.pose.t).into(), reported.time),
            (None, None) => return,
        };
        if position.iter().all(|p| p.is_finite()) {
            self.tracking.update(position, time, bandwidth_hz, self.patience_s);
        }
    }
}
