//! Moves of the mirror by command, as a motorised stage under it makes them.

use std::ops::RangeInclusive;

use tokio::sync::{mpsc, oneshot};
use trifacet_optics::Pose;

use super::Twin;

/// Allowed translations, micrometres.
pub const RANGE_UM: RangeInclusive<f64> = -10_000.0..=10_000.0;
/// Allowed rotations, microradians.
pub const RANGE_URAD: RangeInclusive<f64> = -100_000.0..=100_000.0;
/// Allowed times of a move, seconds.
pub const RANGE_S: RangeInclusive<f64> = 0.0..=60.0;
/// Time of a move, unless the command states it, seconds.
pub const DEFAULT_S: f64 = 1.0;

/// A move of the mirror.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MirrorMove {
    /// tx, ty, tz (micrometres), roll, pitch, yaw (microradians).
    pub micro: [f64; 6],
    /// Duration, seconds.
    pub over_s: f64,
}

impl MirrorMove {
    /// A move whose values are all allowed.
    ///
    /// # Errors
    /// A value is out of range; the message names it and the range.
    pub fn checked(self) -> Result<Self, String> {
        let names = ["tx_um", "ty_um", "tz_um", "roll_urad", "pitch_urad", "yaw_urad"];
        let of_pose = names.into_iter().zip(self.micro).enumerate();
        let of_pose = of_pose.map(|(i, (name, x))| (name, x, if i < 3 { RANGE_UM } else { RANGE_URAD }));
        for (name, x, range) in of_pose.chain([("over_s", self.over_s, RANGE_S)]) {
            if !range.contains(&x) {
                return Err(format!("{name} = {x}: allowed is {} to {}", range.start(), range.end()));
            }
        }
        Ok(self)
    }

    /// The pose at the end of the move.
    pub fn to(&self) -> Pose {
        Pose::from_array(self.micro.map(|x| x * 1e-6))
    }
}

/// A request for a move. `done` is answered when the mirror has arrived; it is dropped if another move begins
/// before that.
pub type MoveRequest = (MirrorMove, oneshot::Sender<()>);

/// The requested moves of a running twin.
#[derive(Debug)]
pub struct Moves {
    requests: mpsc::Receiver<MoveRequest>,
    /// Time of arrival of the present move, seconds since the start of the twin, and where to report it.
    present: Option<(f64, oneshot::Sender<()>)>,
}

impl Moves {
    /// Moves that arrive through this channel.
    pub fn new(requests: mpsc::Receiver<MoveRequest>) -> Self {
        Self { requests, present: None }
    }

    /// Begins the moves that have been requested before the next scan, and reports an arrival.
    pub fn before_scan(&mut self, twin: &mut Twin) {
        while let Ok((requested, done)) = self.requests.try_recv() {
            self.present = Some((twin.travel(requested.to(), requested.over_s), done));
        }
        if let Some((_, done)) = self.present.take_if(|(arrival_s, _)| twin.next_s() > *arrival_s) {
            let _ = done.send(()); // the client may have gone
        }
    }
}
