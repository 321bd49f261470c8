//! Means over reports, on request.

use tokio::sync::oneshot;
use trifacet_core::estimation::PoseReport;
use trifacet_optics::Pose;
use trifacet_wire::{LockState, Status};

/// The mean of some successive reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReportMean {
    /// Mean pose in the world frame of the head. The angles of a sensor are far from where they wrap.
    pub pose: Pose,
    /// Mean offset of the beam from the apex, metres; `None` if a report had none.
    pub offset: Option<[f64; 2]>,
    /// Mean position of the stage by its readback, metres; `None` if a report had none.
    pub readback: Option<[f64; 2]>,
    /// The loop was locked in every report.
    pub locked: bool,
}

/// A mean that was requested.
pub(super) struct RequestedMean {
    count: u32,
    left: u32,
    pose: [f64; 6],
    offset: Option<[f64; 2]>,
    readback: Option<[f64; 2]>,
    locked: bool,
    reply: oneshot::Sender<Result<ReportMean, Status>>,
}

impl RequestedMean {
    pub(super) fn new(count: u32, reply: oneshot::Sender<Result<ReportMean, Status>>) -> Self {
        let count = count.max(1);
        let (offset, readback) = (Some([0.0; 2]), Some([0.0; 2]));
        Self { count, left: count, pose: [0.0; 6], offset, readback, locked: true, reply }
    }

    /// Takes a report; returns `None` once the reply has been sent.
    pub(super) fn push(mut self, report: &PoseReport) -> Option<Self> {
        let Some(pose) = report.pose else {
            let _ = self.reply.send(Err(report.status));
            return None;
        };
        for (sum, x) in self.pose.iter_mut().zip(pose.to_array()) {
            *sum += x;
        }
        self.offset = add(self.offset, report.offset);
        let measured = report.status.has(Status::STEERING_MEASURED);
        self.readback = add(self.readback, report.steering.filter(|_| measured));
        self.locked &= report.lock == LockState::Locked;
        self.left -= 1;
        if self.left > 0 {
            return Some(self);
        }
        let n = f64::from(self.count);
        let mean = |sum: [f64; 2]| sum.map(|sum| sum / n);
        let _ = self.reply.send(Ok(ReportMean {
            pose: Pose::from_array(self.pose.map(|sum| sum / n)),
            offset: self.offset.map(mean),
            readback: self.readback.map(mean),
            locked: self.locked,
        }));
        None
    }
}

/// The sum of both, if both are known.
fn add(sum: Option<[f64; 2]>, x: Option<[f64; 2]>) -> Option<[f64; 2]> {
    sum.zip(x).map(|([a, b], [x, y])| [a + x, b + y])
}
