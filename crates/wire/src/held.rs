//! Keeps the last valid pose, for clients that request it (`POSE_HELD`).

use crate::{PoseFrame, Status};

/// The last valid pose of a stream.
#[derive(Clone, Debug, Default)]
pub struct Hold {
    last: Option<PoseFrame>,
}

impl Hold {
    /// Takes every frame of a stream in turn. For a frame without a valid pose, returns the same frame with
    /// the last valid pose, marked as held. Returns `None` if the pose is valid, or if there has been no
    /// valid pose since the start of the daemon or since the last change of its geometry.
    pub fn next(&mut self, frame: &PoseFrame) -> Option<PoseFrame> {
        if frame.status.has(Status::POSE_VALID) {
            self.last = Some(*frame);
            return None;
        }
        let last = self.last.filter(|last| (last.session, last.config) == (frame.session, frame.config))?;
        Some(PoseFrame {
            status: frame.status | Status::POSE_HELD,
            pose: last.pose,
            deviations: [f32::INFINITY; 6],
            systematic: last.systematic.map(|_| [f32::INFINITY; 6]),
            ..*frame
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_valid_pose_is_marked_as_held_and_dropped_when_it_is_meaningless() {
        let valid = PoseFrame::example();
        let dark = PoseFrame {
            sequence: 10,
            time_ns: 11,
            status: Status::PSD_A_LOW,
            pose: [f64::NAN; 6],
            deviations: [f32::NAN; 6],
            ..valid
        };
        let mut hold = Hold::default();
        assert_eq!(hold.next(&dark), None, "no pose to hold yet");
        assert_eq!(hold.next(&valid), None);
        let held = hold.next(&dark).unwrap();
        assert_eq!(held.pose, valid.pose);
        assert_eq!(held.deviations, [f32::INFINITY; 6]);
        assert_eq!(held.status, Status::PSD_A_LOW | Status::POSE_HELD);
        assert_eq!((held.sequence, held.time_ns), (10, 11));
        assert_eq!(hold.next(&PoseFrame { config: 99, ..dark }), None, "another geometry");
    }
}
