//! The estimation task: publishes a report for each sample or block, and for silence.

pub mod drift;
pub mod light;
pub mod loop_liveness;
mod mean;
pub mod warnings;

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::yield_now;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until};
use trifacet_core::estimation::{Estimation, PoseReport};
use trifacet_core::pipeline::SilenceTimes;
use trifacet_core::signals::Identity;
use trifacet_core::telemetry::heartbeat::HEARTBEAT;
use trifacet_core::time::Clock;
use trifacet_wire::Status;

use crate::acquisition::task::SampleEvent;
use crate::estimation::loop_liveness::LoopLiveness;
use crate::estimation::warnings::Warnings;
use crate::recording::EstimationRecorder;

pub use mean::ReportMean;
use mean::RequestedMean;

/// Channels of the task.
#[derive(Debug)]
pub struct EstimationLinks<Publish> {
    /// Samples in order, from acquisition.
    pub samples: mpsc::Receiver<SampleEvent>,
    /// Requests from outside the fast side.
    pub questions: mpsc::Receiver<EstimationRequest>,
    /// State of the loop, from centering.
    pub steering: LoopLiveness,
    /// The newest report, in the world frame of the head, to centering.
    pub newest: watch::Sender<Option<PoseReport>>,
    /// Every report, in the user's frame, to publishing.
    pub publish: Publish,
    /// Inputs of estimation, for the recorder.
    pub recorder: EstimationRecorder,
    /// Warnings and doubts.
    pub warnings: Warnings,
}

/// Requests to estimation.
#[derive(Debug)]
pub enum EstimationRequest {
    /// The last published report, if there is one.
    Last(oneshot::Sender<Option<PoseReport>>),
    /// The mean of this many reports, from the next one on. The first report without a pose ends the request with
    /// its status. A second request of this kind ends the first.
    Mean(u32, oneshot::Sender<Result<ReportMean, Status>>),
}

/// Runs until acquisition ends. `rate_hz` is the expected rate of samples, `silence` the shortest silence that is
/// reported.
pub async fn run<C: Clock>(
    mut estimation: Estimation,
    rate_hz: f64,
    silence: Duration,
    clock: C,
    links: EstimationLinks<impl FnMut(&PoseReport)>,
) {
    let EstimationLinks { mut samples, mut questions, mut steering, newest, .. } = links;
    let EstimationLinks { mut publish, mut recorder, mut warnings, .. } = links;
    let mut silence_timer = SilenceTimer::new(rate_hz, silence);
    let mut last = None;
    let mut mean: Option<RequestedMean> = None;
    let mut heartbeat = interval(HEARTBEAT);
    heartbeat.set_missed_tick_behavior(MissedTickBehavior::Delay); // one check after the thread was suspended
    loop {
        let report = tokio::select! {
            biased;
            Some(question) = questions.recv() => {
                match question {
                    // A requester that no longer waits for the reply does not need it.
                    EstimationRequest::Last(reply) => drop(reply.send(last)),
                    EstimationRequest::Mean(count, reply) => mean = Some(RequestedMean::new(count, reply)),
                }
                None
            }
            acquired = samples.recv() => match acquired {
                None => break,
                Some(SampleEvent::Up(identity)) => {
                    silence_timer = silence_timer.of(&identity);
                    warnings.source(&identity, estimation.fuses());
                    estimation.source(Arc::clone(&identity));
                    recorder.source(identity);
                    None
                }
                Some(SampleEvent::Sample(sample, scan)) => {
                    silence_timer.restart();
                    warnings.sample(&sample);
                    let steering = steering.now();
                    recorder.sample(&sample, scan, &steering, estimation.memory());
                    estimation.sample(&sample, &steering)
                }
                Some(SampleEvent::Changed(change)) => {
                    estimation.retune(change.settings);
                    warnings.retune(&change.context, estimation.fuses());
                    recorder.context(change.context);
                    let _ = change.done.send(());
                    None
                }
                // Reported at once, not after the next silence.
                Some(SampleEvent::Down(down)) => {
                    silence_timer.silent();
                    let (now, steering) = (clock.now(), steering.now());
                    recorder.silence(now, &steering, Some(down), estimation.memory());
                    Some(estimation.silence(now, &steering))
                }
            },
            () = sleep_until(silence_timer.next) => {
                // The whole thread may have been suspended: samples that have arrived since then are handled
                // first.
                yield_now().await;
                if !samples.is_empty() {
                    continue;
                }
                silence_timer.silent();
                let (now, steering) = (clock.now(), steering.now());
                recorder.silence(now, &steering, None, estimation.memory());
                Some(estimation.silence(now, &steering))
            }
            _ = heartbeat.tick() => {
                steering.look();
                None
            }
        };
        if let Some(mut report) = report {
            report.solved = clock.now();
            warnings.report(&report);
            let published = estimation.in_user_frame(&report);
            publish(&published);
            last = Some(published);
            mean = mean.and_then(|mean| mean.push(&report));
            newest.send_replace(Some(report));
        }
    }
}

/// Schedule of the reports during silence.
struct SilenceTimer {
    shortest: Duration,
    times: SilenceTimes,
    next: Instant,
}

impl SilenceTimer {
    fn new(rate_hz: f64, shortest: Duration) -> Self {
        let times = SilenceTimes::new(rate_hz, shortest);
        Self { shortest, times, next: Instant::now() + times.first }
    }

    /// The timer for another source; the silence so far counts.
    fn of(&self, identity: &Identity) -> Self {
        Self { next: self.next, ..Self::new(identity.rate_hz, self.shortest) }
    }

    fn restart(&mut self) {
        self.next = Instant::now() + self.times.first;
    }

    fn silent(&mut self) {
        self.next = Instant::now() + self.times.repeat;
    }
}
