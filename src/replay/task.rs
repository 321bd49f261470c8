//! The task of a daemon that replays a recording, in place of acquisition, centering and estimation. There is
//! no steering: the recorded state of the loop comes with the samples.

use std::time::Duration;

use tokio::time::sleep;
use tokio_util::sync::CancellationToken;
use trifacet_core::time::Clock;

use super::player::{Player, Recording};
use super::republisher::Republished;
use crate::config::CalibrationContext;
use crate::control::FastLink;
use crate::estimation::EstimationRequest;

/// Interval of checking for due entries: the resolution of timers of the runtime.
const TICK: Duration = Duration::from_millis(1);

/// Connections of the task.
#[derive(Debug)]
pub struct ReplayLinks<Publish, Means> {
    /// Requests from outside the fast side.
    pub control: FastLink,
    /// Receives every report, in the user's frame.
    pub publish: Publish,
    /// Receives the configuration that applies from the next report on.
    pub means: Means,
}

/// Runs until `stop`.
pub async fn run<C: Clock>(
    recording: Recording,
    clock: C,
    links: ReplayLinks<impl FnMut(&Republished), impl FnMut(&CalibrationContext)>,
    stop: CancellationToken,
) {
    let ReplayLinks { control, publish, means } = links;
    let FastLink { changes: _changes, mut questions, mut orders, .. } = control;
    let mut player = Player::new(recording, clock, publish, means);
    loop {
        tokio::select! {
            biased;
            () = stop.cancelled() => break,
            Some(question) = questions.recv() => match question {
                // A closed channel means that the caller does not wait any more.
                EstimationRequest::Last(reply) => drop(reply.send(player.last())),
                EstimationRequest::Mean(_, reply) => drop(reply),
            },
            Some(order) = orders.recv() => player.obey(order),
            () = sleep(TICK) => player.play(),
        }
    }
}
