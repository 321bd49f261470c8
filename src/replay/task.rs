//! The task of a daemon that replays: in place of acquisition, centering and estimation. Nothing steers here: what the
//! loop did then comes with the samples.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::sleep;
use tokio_util::sync::CancellationToken;
use trifacet_core::estimation::Estimation;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::Clock;

use super::RecordingHeader;
use super::player::Player;
use super::republisher::Republished;
use crate::config::{CalibrationContext, ReplayConfig};
use crate::control::FastLink;
use crate::estimation::EstimationRequest;

/// How often is looked whether something is due: a timer of the runtime is not finer.
const TICK: Duration = Duration::from_millis(1);

/// Where things go.
#[derive(Debug)]
pub struct ReplayLinks<Publish, Means> {
    /// Questions and orders from outside of the fast side.
    pub control: FastLink,
    /// Every report, in the user's frame.
    pub publish: Publish,
    /// What poses mean from the next report on.
    pub means: Means,
}

/// What is replayed, and how.
#[derive(Debug)]
pub struct Recording {
    /// Where it is, and its pace.
    pub config: ReplayConfig,
    /// What it says at its beginning.
    pub beginning: RecordingHeader,
    /// That of the beginning: it says what there is to say while nothing is due.
    pub estimation: Estimation,
    /// Counts what is replayed, as if it came from a source.
    pub counters: Arc<Counters>,
}

/// Runs until `stop`.
pub async fn run<C: Clock>(
    recording: Recording,
    clock: C,
    edges: ReplayLinks<impl FnMut(&Republished), impl FnMut(&CalibrationContext)>,
    stop: CancellationToken,
) {
    let ReplayLinks { control, publish, means } = edges;
    let FastLink { changes: _changes, mut questions, mut orders } = control;
    let mut player = Player::new(recording, clock, publish, means);
    loop {
        tokio::select! {
            biased;
            () = stop.cancelled() => break,
            Some(question) = questions.recv() => match question {
                // Who does not wait for the answer any more does not need it.
                EstimationRequest::Last(reply) => drop(reply.send(player.last())),
                EstimationRequest::Mean(_, reply) => drop(reply),
            },
            Some(order) = orders.recv() => player.obey(order),
            () = sleep(TICK) => player.play(),
        }
    }
}
