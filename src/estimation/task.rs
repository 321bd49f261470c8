//! The task: samples in, reports out, at once; and when no samples come, that.

use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::{
    task::yield_now,
    time::{Instant, sleep_until},
};

use super::{Estimation, PoseReport};
use crate::acquisition::{Identity, task::Acquired};
use crate::centering::LoopState;
use crate::clock::Clock;

/// How often silence is reported, at most.
const SILENCE_HZ: f64 = 100.0;
/// The shortest silence that counts.
const PATIENCE: Duration = Duration::from_millis(20);

/// The edges of the task.
#[derive(Debug)]
pub struct Edges<Publish> {
    /// Samples in order, from acquisition.
    pub samples: mpsc::Receiver<Acquired>,
    /// What the loop does, from centering.
    pub steering: watch::Receiver<LoopState>,
    /// The newest report, to centering.
    pub newest: watch::Sender<Option<PoseReport>>,
    /// Every report, to publishing.
    pub publish: Publish,
}

/// Runs until acquisition ends. `rate_hz` is the expected rate of samples.
pub async fn run<C: Clock>(
    mut estimation: Estimation,
    rate_hz: f64,
    clock: C,
    edges: Edges<impl FnMut(&PoseReport)>,
) {
    let Edges { mut samples, steering, newest, mut publish } = edges;
    let mut rhythm = Rhythm::new(rate_hz);
    loop {
        let report = tokio::select! {
            biased;
            acquired = samples.recv() => match acquired {
                None => break,
                Some(Acquired::Up(identity)) => {
                    rhythm = rhythm.of(&identity);
                    estimation.source(identity.simulated);
                    None
                }
                Some(Acquired::Sample(sample)) => {
                    rhythm.heard();
                    let steering = *steering.borrow();
                    estimation.sample(&sample, &steering)
                }
                // Said at once, not after the next silence.
                Some(Acquired::Down(_)) => {
                    rhythm.silent();
                    let steering = *steering.borrow();
                    Some(estimation.silence(clock.now(), &steering))
                }
            },
            () = sleep_until(rhythm.next) => {
                // The whole thread may have slept: what has come in the meantime has its turn first.
                yield_now().await;
                if !samples.is_empty() {
                    continue;
                }
                rhythm.silent();
                let steering = *steering.borrow();
                Some(estimation.silence(clock.now(), &steering))
            }
        };
        if let Some(mut report) = report {
            report.solved = clock.now();
            publish(&report);
            newest.send_replace(Some(report));
        }
    }
}

/// When silence is to be reported.
struct Rhythm {
    patience: Duration,
    repeat: Duration,
    next: Instant,
}

impl Rhythm {
    fn new(rate_hz: f64) -> Self {
        let patience = PATIENCE.max(Duration::from_secs_f64(5.0 / rate_hz));
        let repeat = Duration::from_secs_f64(1.0 / rate_hz.min(SILENCE_HZ));
        Self { patience, repeat, next: Instant::now() + patience }
    }

    /// The rhythm of another source; the silence so far counts.
    fn of(&self, identity: &Identity) -> Self {
        Self { next: self.next, ..Self::new(identity.rate_hz) }
    }

    fn heard(&mut self) {
        self.next = Instant::now() + self.patience;
    }

    fn silent(&mut self) {
        self.next = Instant::now() + self.repeat;
    }
}
