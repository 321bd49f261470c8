//! The task of a daemon that replays: in place of acquisition, centering and estimation. Nothing steers here: what the
//! loop did then comes with the samples.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::sleep;
use tokio_util::sync::CancellationToken;
use trifacet_core::estimation::Estimation;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::Clock;

use super::Beginning;
use super::player::Player;
use super::teller::Told;
use crate::config::{Meaning, ReplayConfig};
use crate::control::AtFast;
use crate::estimation::Question;

/// How often is looked whether something is due: a timer of the runtime is not finer.
const TICK: Duration = Duration::from_millis(1);

/// Where things go.
#[derive(Debug)]
pub struct Edges<Publish, Means> {
    /// Questions and orders from outside of the fast side.
    pub control: AtFast,
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
    pub beginning: Beginning,
    /// That of the beginning: it says what there is to say while nothing is due.
    pub estimation: Estimation,
    /// Counts what is replayed, as if it came from a source.
    pub counters: Arc<Counters>,
}

/// Runs until `stop`.
pub async fn run<C: Clock>(
    recording: Recording,
    clock: C,
    edges: Edges<impl FnMut(&Told), impl FnMut(&Meaning)>,
    stop: CancellationToken,
) {
    let Edges { control, publish, means } = edges;
    let AtFast { changes: _changes, mut questions, mut orders } = control;
    let mut player = Player::new(recording, clock, publish, means);
    loop {
        tokio::select! {
            biased;
            () = stop.cancelled() => break,
            Some(question) = questions.recv() => match question {
                // Who does not wait for the answer any more does not need it.
                Question::Last(reply) => drop(reply.send(player.last())),
                Question::Mean(_, reply) => drop(reply),
            },
            Some(order) = orders.recv() => player.obey(order),
            () = sleep(TICK) => player.play(),
        }
    }
}
