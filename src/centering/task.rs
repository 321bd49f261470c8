//! The task: newest sample in, command out; holds on silence; holds or parks at the end.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::yield_now;
use tokio::time::{sleep, timeout};
use tokio_util::sync::CancellationToken;

use super::core::{Centering, LoopState, LoopView, Tuning};
use super::lock::Transition;
use crate::acquisition::{Identity, OutputCommand, Sample, task::Newest};
use crate::clock::{Clock, Mono};
use crate::estimation::PoseReport;
use crate::monitor::Counters;
use crate::optics::Pose;

/// A pose older than this says nothing of the wedges now. Seconds.
const FRESH_S: f64 = 0.1;
/// How long the last command may wait for its acknowledgement.
const LAST_ACK: Duration = Duration::from_secs(1);
/// How often silence is noticed.
const PATIENCE: Duration = Duration::from_millis(20);

/// The edges of the task.
#[derive(Debug)]
pub struct Edges {
    /// The newest sample and answer, from acquisition.
    pub newest: watch::Receiver<Newest>,
    /// The newest report, from estimation.
    pub poses: watch::Receiver<Option<PoseReport>>,
    /// Commands, back to acquisition.
    pub commands: watch::Sender<Option<OutputCommand>>,
    /// What the loop does, to estimation.
    pub state: watch::Sender<LoopState>,
    /// Orders from outside of the fast side.
    pub orders: mpsc::Receiver<Order>,
}

/// What the loop may be told, and asked.
#[derive(Debug)]
pub enum Order {
    /// To go on with another tuning; the answer says that it does.
    Retune(Box<Tuning>, oneshot::Sender<()>),
    /// What it is doing.
    View(oneshot::Sender<LoopView>),
}

/// Runs until `stop`; then sends the last command and waits for its acknowledgement.
pub async fn run<C: Clock>(
    mut centering: Centering,
    clock: C,
    counters: Arc<Counters>,
    mut edges: Edges,
    stop: CancellationToken,
) {
    let mut source: Option<Arc<Identity>> = None;
    let mut heard = clock.now();
    loop {
        tokio::select! {
            biased;
            () = stop.cancelled() => break,
            Some(order) = edges.orders.recv() => {
                let output_bits = source.as_ref().map(|identity| identity.output_bits);
                obey(&mut centering, order, output_bits, &edges);
            }
            changed = edges.newest.changed() => {
                if changed.is_err() {
                    break; // acquisition has ended; the daemon sees that
                }
                let newest = edges.newest.borrow_and_update().clone();
                if let Some(now) = newest.source
                    && !source.as_ref().is_some_and(|before| Arc::ptr_eq(before, &now))
                {
                    source = Some(now);
                    centering.source_changed();
                }
                if let (Some(identity), Some(sample)) = (&source, &newest.sample)
                    && let Some(skipped) = centering.skipped(sample)
                {
                    counters.centering_skips.add(skipped);
                    heard = clock.now();
                    let late = act(&mut centering, sample, heard, identity.output_bits, &edges);
                    counters.centering_skips.add(u64::from(late));
                }
            }
            () = sleep(PATIENCE) => {
                // The whole thread may have slept: what has come in the meantime has its turn first.
                yield_now().await;
                if edges.newest.has_changed().unwrap_or(true) {
                    continue;
                }
                let now = clock.now();
                say(centering.silence(now.seconds_since(heard)));
                heard = now;
            }
        }
        edges.state.send_if_modified(|state| std::mem::replace(state, centering.state()) != *state);
    }
    if let Some(identity) = source
        && let Some(last) = centering.finish(identity.output_bits)
    {
        finish(last, &mut edges).await;
    }
}

fn obey(centering: &mut Centering, order: Order, output_bits: Option<u8>, edges: &Edges) {
    // Who does not wait for the answer any more does not need it.
    match order {
        Order::Retune(tuning, done) => {
            let outcome = centering.retune(*tuning, output_bits);
            if let Some(command) = outcome.command {
                edges.commands.send_replace(Some(command));
            }
            say(outcome.transition);
            let _ = done.send(());
        }
        Order::View(reply) => drop(reply.send(centering.view())),
    }
}

/// Acts on a sample, unless it comes too late: says whether it does.
fn act(centering: &mut Centering, sample: &Sample, now: Mono, output_bits: u8, edges: &Edges) -> bool {
    let pose = fresh_pose(&edges.poses, sample);
    let outcome = centering.sample(sample, pose.as_ref(), now, output_bits);
    if let Some(command) = outcome.command {
        edges.commands.send_replace(Some(command));
    }
    say(outcome.transition);
    outcome.late
}

fn fresh_pose(poses: &watch::Receiver<Option<PoseReport>>, sample: &Sample) -> Option<Pose> {
    let report = (*poses.borrow())?;
    let fresh = sample.time.seconds_since(report.time).abs() <= FRESH_S;
    report.pose.filter(|_| fresh)
}

fn say(transition: Option<Transition>) {
    if let Some(Transition { from, to, cause }) = transition {
        tracing::info!(from = from.name(), to = to.name(), cause, "lock");
    }
}

async fn finish(last: OutputCommand, edges: &mut Edges) {
    edges.commands.send_replace(Some(last));
    let mine = |newest: &Newest| newest.ack.is_some_and(|ack| ack.id == last.id);
    let answered = timeout(LAST_ACK, edges.newest.wait_for(mine)).await;
    let accepted = answered.ok().and_then(Result::ok).and_then(|newest| newest.ack).map(|ack| ack.accepted);
    let lease_ms = last.lease_ms;
    let complaint = match accepted {
        Some(true) => {
            tracing::info!(codes = ?last.codes, "steering acknowledged its last command");
            return;
        }
        Some(false) => "steering refused its last command; the lease of the one before will end it",
        None => "steering did not acknowledge its last command; its lease will end it",
    };
    tracing::warn!(lease_ms, "{complaint}");
}
