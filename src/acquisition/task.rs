//! The acquisition task: reads the source, maps channels, passes samples on, and sends steering commands.

use std::sync::Arc;

use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::mpsc::{self};
use tokio::sync::{oneshot, watch};
use tokio::task::yield_now;
use tokio::time::interval;
use tokio_util::sync::CancellationToken;
use trifacet_core::channels::Channels;
use trifacet_core::pipeline::Mapping;
use trifacet_core::signals::{Identity, Sample, Scan};
use trifacet_core::telemetry::Counters;
use trifacet_core::telemetry::heartbeat::HEARTBEAT;
use trifacet_core::time::Clock;
use trifacet_wire::channel::Role;

use super::{Source, SourceError, SourceEvent};
use crate::config::CalibrationContext;
use crate::steering::outputs::{Answers, OutputLink};

/// After this number of events the other tasks of the thread run, also if more events wait: on a machine that is too
/// slow, a source always has one.
const BATCH: u32 = 64;

/// Events for estimation, in order.
#[derive(Debug)]
pub enum SampleEvent {
    /// The source is ready.
    Up(Arc<Identity>),
    /// A sample, with its scan.
    Sample(Sample, Scan),
    /// Samples and poses have other settings from here on.
    Changed(Box<SettingsChange>),
    /// There are no samples, for this reason.
    Down(SourceError),
}

/// New settings for samples and poses. A change is passed in order with the samples, so that each sample is
/// evaluated with its own settings.
#[derive(Debug)]
pub struct SettingsChange {
    /// A new channel map; applied and removed by acquisition.
    pub channels: Option<Channels>,
    /// New settings of estimation.
    pub settings: trifacet_core::estimation::Settings,
    /// The settings as recorded.
    pub context: Arc<CalibrationContext>,
    /// Receives a message when the change is in effect.
    pub done: oneshot::Sender<()>,
}

/// Channels of the task.
#[derive(Debug)]
pub struct AcquisitionLinks {
    /// Samples in order, to estimation.
    pub samples: mpsc::Sender<SampleEvent>,
    /// The newest sample, to centering.
    pub newest: watch::Sender<Option<Sample>>,
    /// Why the source is down; `None` while samples arrive.
    pub down: watch::Sender<Option<SourceError>>,
    /// Steering commands from the driver of the outputs, and acknowledgements to it.
    pub outputs: OutputLink,
    /// Changes of settings, from outside the fast side.
    pub changes: mpsc::Receiver<SettingsChange>,
}

/// Runs until `stop`, then closes the source.
pub async fn run<S: Source, C: Clock>(
    mut source: S,
    mapping: Mapping,
    clock: C,
    counters: Arc<Counters>,
    links: AcquisitionLinks,
    stop: CancellationToken,
) {
    let AcquisitionLinks { samples, newest, outputs, down, mut changes } = links;
    let OutputLink { mut commands, answers } = outputs;
    let mut intake = Intake {
        mapping,
        counters,
        samples,
        newest,
        answers,
        why_down: down,
        up: false,
        frozen: Vec::new(),
        dropped: 0,
        change: None,
    };
    let mut heartbeat = interval(HEARTBEAT);
    let mut events = 0_u32;
    loop {
        tokio::select! {
            biased;
            () = stop.cancelled() => break,
            Ok(()) = commands.changed() => {
                if let Some(command) = *commands.borrow_and_update() {
                    intake.counters.commands_sent.inc();
                    source.steer(command, clock.now());
                }
            }
            Some(change) = changes.recv() => intake.change(change),
            event = source.next() => {
                intake.take(event);
                events = events.wrapping_add(1);
                if events.is_multiple_of(BATCH) {
                    yield_now().await;
                }
            }
            _ = heartbeat.tick() => {}
        }
    }
    source.close().await;
}

/// Handling of events.
struct Intake {
    mapping: Mapping,
    counters: Arc<Counters>,
    samples: mpsc::Sender<SampleEvent>,
    newest: watch::Sender<Option<Sample>>,
    answers: watch::Sender<Answers>,
    why_down: watch::Sender<Option<SourceError>>,
    /// Scans are arriving.
    up: bool,
    /// Channels that repeat the same code.
    frozen: Vec<Role>,
    /// Samples dropped because the queue to estimation was full, since the last one that was passed on.
    dropped: u32,
    /// A change that waits for room in the queue to estimation: no sample may overtake it.
    change: Option<Box<SettingsChange>>,
}

impl Intake {
    fn take(&mut self, event: SourceEvent) {
        match event {
            SourceEvent::Up(identity) => self.up(identity),
            SourceEvent::Scan(scan) => {
                self.counters.scans.inc();
                if let Some(sample) = self.mapping.sample(&scan) {
                    if !std::mem::replace(&mut self.up, true) {
                        tracing::info!("receiving scans");
                        self.why_down.send_replace(None);
                        let identity = self.mapping.identity().cloned();
                        self.answers.send_modify(|answers| answers.source = identity);
                    }
                    self.name_frozen();
                    self.newest.send_replace(Some(sample));
                    self.hand_on(sample, scan);
                }
            }
            SourceEvent::Ack(ack) => {
                if !ack.accepted {
                    self.counters.commands_refused.inc();
                }
                self.answers.send_modify(|answers| answers.ack = Some(ack));
            }
            SourceEvent::Down(down) => self.down(down),
        }
    }

    /// Logs the channels that have frozen, and those that have recovered.
    fn name_frozen(&mut self) {
        let frozen: Vec<Role> = self.mapping.frozen().collect();
        for channel in frozen.iter().filter(|channel| !self.frozen.contains(channel)) {
            tracing::warn!(%channel, "a channel repeats the same code although its signal has noise");
        }
        for channel in self.frozen.iter().filter(|channel| !frozen.contains(channel)) {
            tracing::info!(%channel, "the code of the channel changes again");
        }
        self.frozen = frozen;
    }

    fn up(&mut self, identity: Identity) {
        let identity = Arc::new(identity);
        match self.mapping.source(Arc::clone(&identity)) {
            Ok(()) => {
                tracing::info!(name = identity.name, rate_hz = identity.rate_hz, "source is up");
                self.tell(SampleEvent::Up(identity));
            }
            Err(missing) => {
                let (what, reason) = (identity.name.clone(), missing.to_string());
                self.down(SourceError::Unfit { what, reason });
            }
        }
    }

    fn down(&mut self, down: SourceError) {
        // One fault may have several reasons in turn: first unplugged, then impossible to open.
        if std::mem::replace(&mut self.up, false) {
            self.counters.source_downs.inc();
        }
        tracing::warn!(reason = %down, "source is down");
        self.why_down.send_replace(Some(down.clone()));
        self.tell(SampleEvent::Down(down));
    }

    fn change(&mut self, mut change: SettingsChange) {
        if let Some(channels) = change.channels.take() {
            self.mapping.set_channels(channels);
        }
        self.change = Some(Box::new(change)); // an older one that still waits is obsolete
        self.pass_change();
    }

    /// Passes a waiting change on; returns false if the change still waits.
    fn pass_change(&mut self) -> bool {
        let Some(change) = self.change.take() else { return true };
        if let Err(TrySendError::Full(SampleEvent::Changed(change))) =
            self.samples.try_send(SampleEvent::Changed(change))
        {
            self.change = Some(change);
        }
        self.change.is_none()
    }

    fn hand_on(&mut self, mut sample: Sample, scan: Scan) {
        sample.lost = sample.lost.saturating_add(self.dropped);
        let sample_of = SampleEvent::Sample(sample, scan);
        let sent = if self.pass_change() {
            self.samples.try_send(sample_of)
        } else {
            Err(TrySendError::Full(sample_of))
        };
        match sent {
            Ok(()) => self.dropped = 0,
            Err(TrySendError::Full(_)) => {
                self.counters.estimation_overflows.inc();
                self.dropped = sample.lost.saturating_add(1);
            }
            // Estimation has ended; the daemon detects that and ends too.
            Err(TrySendError::Closed(_)) => {}
        }
    }

    /// Passes on an event of the source. If the queue is full, estimation still has older samples to process,
    /// and then detects the silence after them.
    fn tell(&self, news: SampleEvent) {
        if self.samples.try_send(news).is_err() {
            self.counters.estimation_overflows.inc();
        }
    }
}

#[cfg(test)]
mod tests {
    use trifacet_core::signals::PsdState;
    use trifacet_core::time::Mono;
    use trifacet_wire::channel::MAX_CHANNELS;

    use super::*;
    use crate::config::{CalibrationState, Config};

    fn sample(index: u64) -> Sample {
        Sample {
            index,
            time: Mono(index as i64),
            time_sigma_ns: None,
            lost: 0,
            spots: [0.0; 6],
            powers: [0.0; 3],
            psds: [PsdState::Good; 3],
            steering: None,
            output_railed: false,
            applied: None,
            uncovered: false,
        }
    }

    fn scan(index: u64) -> Scan {
        let (time, codes) = (Mono(index as i64), [0; MAX_CHANNELS]);
        Scan { index, time, time_sigma_ns: None, lost: 0, codes, output_railed: false, applied: None }
    }

    fn intake(config: &Config) -> (Intake, mpsc::Receiver<SampleEvent>) {
        let (samples, estimation) = mpsc::channel(3);
        let intake = Intake {
            mapping: Mapping::new(config.read_channels().unwrap()),
            counters: Arc::default(),
            samples,
            newest: watch::Sender::default(),
            answers: watch::Sender::default(),
            why_down: watch::Sender::default(),
            up: false,
            frozen: Vec::new(),
            dropped: 0,
            change: None,
        };
        (intake, estimation)
    }

    #[test]
    fn a_source_that_cannot_be_used_is_named() {
        let (mut intake, mut estimation) = intake(&Config::default());
        let mut identity = Identity::example();
        identity.roles[1] = Role::Auxiliary;
        intake.up(identity);
        let Ok(SampleEvent::Down(reason)) = estimation.try_recv() else { panic!("no reason") };
        assert_eq!(reason.to_string(), "example board cannot be used: it has no channel for v of PSD A");
    }

    #[test]
    fn no_sample_overtakes_a_change_and_every_loss_is_counted() {
        let config = Config::default();
        let (mut intake, mut estimation) = intake(&config);
        let change = || {
            let settings = config.estimation_settings(&CalibrationState::default(), 7).unwrap();
            SettingsChange { channels: None, settings, context: Arc::default(), done: oneshot::channel().0 }
        };
        for index in 1..=3 {
            intake.hand_on(sample(index), scan(index));
        }
        intake.change(change()); // no room
        let mut took = Vec::new();
        let mut take = |estimation: &mut mpsc::Receiver<SampleEvent>| match estimation.try_recv() {
            Ok(SampleEvent::Sample(sample, _)) => took.push((sample.index, sample.lost)),
            Ok(SampleEvent::Changed(_)) => took.push((0, 0)),
            other => panic!("{other:?}"),
        };
        intake.hand_on(sample(4), scan(4)); // no room
        take(&mut estimation);
        intake.hand_on(sample(5), scan(5)); // room for the change alone
        (0..3).for_each(|_| take(&mut estimation));
        intake.hand_on(sample(6), scan(6));
        take(&mut estimation);
        assert_eq!(took, [(1, 0), (2, 0), (3, 0), (0, 0), (6, 2)]);
        assert_eq!(intake.counters.estimation_overflows.get(), 2);
    }
}
