//! The head during a calibration: source, loop and stage in one task.
//!
//! The loop keeps the beam on the apex as in the daemon. What comes out are samples before correction tables and
//! power gains; everything is recorded as in the daemon.

use std::sync::Arc;
use std::time::Duration;

use tokio::task::yield_now;
use tokio::time::{Instant, sleep, sleep_until, timeout};
use tokio_util::sync::CancellationToken;
use trifacet_core::centering::{LoopMode, LoopParams, OnExit};
use trifacet_core::channels::Channels;
use trifacet_core::estimation::PoseReport;
use trifacet_core::pipeline::{Mapping, Pipeline};
use trifacet_core::signals::{Identity, Scan};
use trifacet_core::stamp::Stamp;
use trifacet_core::steering::{Command, StagePosition};
use trifacet_core::time::Clock;
use trifacet_wire::LockState;
use trifacet_wire::actuator::Ack;

use super::reading::{Flaw, RawSample, Steps};
use crate::acquisition::{Source, SourceEvent};
use crate::config::{CalibrationContext, Config};
use crate::exit::{self, Failure};
use crate::recording::{Entry, EstimationRecorder, RecordSender};
use crate::steering::outputs::Answers;
use crate::steering::{Driver, OutputLink, StageDriver, StageEvent};

/// Longest time without a sample.
const SILENCE: Duration = Duration::from_secs(10);
/// Longest wait for the acknowledgement of the last command.
const LAST_ACK: Duration = Duration::from_secs(1);
/// After this number of events the other tasks run, although more events wait.
const BATCH: u32 = 64;
/// Records that a simulation leaves room for: it waits for the recorder instead of losing records.
const ROOM: usize = 64 * 1024;
const RECORDER_WAIT: Duration = Duration::from_millis(5);

/// The head with its loop.
pub struct Bench<S, C> {
    source: S,
    clock: C,
    driver: StageDriver,
    outputs: OutputLink,
    pipeline: Pipeline,
    params: LoopParams,
    raw_channels: Channels,
    raw: Mapping,
    steps: Steps,
    recorder: EstimationRecorder,
    records: RecordSender,
    /// Number of frames so far.
    frames: u64,
    stop: CancellationToken,
    simulated: bool,
    /// The stop was noticed, and the stage is parked.
    ending: bool,
    /// Position that the stage reports beside the samples.
    reported: Option<StagePosition>,
    last_ack: Option<Ack>,
    /// Why there are no samples.
    source_trouble: Option<String>,
    /// Why the stage takes no commands.
    stage_trouble: Option<String>,
    deadline: Instant,
    events: u32,
}

/// What a bench is connected to.
pub struct Links<S, C> {
    /// The source.
    pub source: S,
    /// Its clock.
    pub clock: C,
    /// The driver of the stage, and the outputs on the side of the source.
    pub stage: (StageDriver, OutputLink),
    /// Takes the records.
    pub records: RecordSender,
    /// Interrupts the measurement.
    pub stop: CancellationToken,
    /// The clock is simulated: time passes only while the bench takes samples.
    pub simulated: bool,
}

impl<S: Source, C: Clock> Bench<S, C> {
    /// A bench before its first sample. The loop is on, and the stage parks at the end, whatever is configured.
    ///
    /// # Errors
    /// [`exit::CONFIG`] if the configuration does not describe a head.
    pub fn new(config: &Config, links: Links<S, C>) -> Result<Self, Failure> {
        let Links { source, clock, stage: (driver, outputs), records, stop, simulated } = links;
        let wrong = |e: &dyn std::fmt::Display| Failure::new(exit::CONFIG, e.to_string());
        let mut config = config.clone();
        config.centering.mode = LoopMode::On;
        let context = CalibrationContext::read(config.clone()).map_err(|e| wrong(&e))?;
        let mut raw_channels = config.channels(&context.tables)?;
        for psd in &mut raw_channels.psds {
            psd.correction = None;
            psd.gain[2] = 1.0;
        }
        let mut pipeline = config.pipeline(&context)?;
        let params = LoopParams { on_exit: OnExit::Park, ..config.loop_params() };
        let _ = pipeline.centering().retune(params); // no sample yet, so no command
        Ok(Self {
            source,
            clock,
            driver,
            outputs,
            pipeline,
            params,
            raw: Mapping::new(raw_channels.clone()),
            raw_channels,
            steps: Steps::default(),
            recorder: EstimationRecorder::new(records.clone(), Arc::new(context)),
            records,
            frames: 0,
            stop,
            simulated,
            ending: false,
            reported: None,
            last_ack: None,
            source_trouble: None,
            stage_trouble: None,
            deadline: Instant::now() + SILENCE,
            events: 0,
        })
    }

    /// The next sample. Cancel-safe.
    ///
    /// # Errors
    /// [`exit::INTERRUPTED`] after a stop, [`exit::UNAVAILABLE`] if no samples arrive, [`exit::CONFIG`] if the
    /// source does not measure the nine signals.
    pub async fn next(&mut self) -> Result<RawSample, Failure> {
        if self.simulated {
            self.deadline = Instant::now() + SILENCE; // it may have stood still
        }
        loop {
            self.events = self.events.wrapping_add(1);
            if self.events.is_multiple_of(BATCH) {
                yield_now().await;
            }
            tokio::select! {
                biased;
                () = self.stop.cancelled(), if !self.ending => {
                    return Err(Failure::new(exit::INTERRUPTED, "interrupted"));
                }
                Ok(()) = self.outputs.commands.changed() => {
                    if let Some(command) = *self.outputs.commands.borrow_and_update() {
                        self.source.steer(command, self.clock.now());
                    }
                }
                event = self.driver.next() => self.hear(event),
                event = self.source.next() => {
                    if let Some(sample) = self.take(event)? {
                        return Ok(sample);
                    }
                }
                () = sleep_until(self.deadline) => {
                    let why = self.source_trouble.as_deref().unwrap_or("the source sends no scans");
                    return Err(Failure::new(exit::UNAVAILABLE, format!("no samples: {why}")));
                }
            }
        }
    }

    /// Waits for something outside. The loop goes on; a simulation stands still.
    ///
    /// # Errors
    /// As [`Bench::next`].
    pub async fn wait_for<T>(&mut self, outside: impl Future<Output = T>) -> Result<T, Failure> {
        if !self.simulated {
            return self.run_until(outside).await;
        }
        tokio::select! {
            biased;
            () = self.stop.cancelled() => Err(Failure::new(exit::INTERRUPTED, "interrupted")),
            done = outside => Ok(done),
        }
    }

    /// Discards samples until another future is ready.
    ///
    /// # Errors
    /// As [`Bench::next`].
    pub async fn run_until<T>(&mut self, other: impl Future<Output = T>) -> Result<T, Failure> {
        tokio::pin!(other);
        loop {
            tokio::select! {
                biased;
                done = &mut other => return Ok(done),
                sample = self.next() => drop(sample?),
            }
        }
    }

    /// In a simulation, which runs faster than the recorder writes, waits until the recorder has room.
    pub async fn wait_for_recorder(&self) {
        while self.simulated && self.records.room().is_some_and(|room| room < ROOM) {
            sleep(RECORDER_WAIT).await;
        }
    }

    /// The smallest differences of readings.
    pub fn steps(&self) -> &Steps {
        &self.steps
    }

    /// Samples per second.
    pub fn rate_hz(&self) -> f64 {
        1.0 / self.params.period_s
    }

    /// The parameters of the loop.
    pub fn params(&self) -> &LoopParams {
        &self.params
    }

    /// Why the stage takes no commands, if it does not.
    pub fn stage_trouble(&self) -> Option<&str> {
        self.stage_trouble.as_deref()
    }

    /// Last commanded position of the stage.
    pub fn commanded(&mut self) -> Option<StagePosition> {
        self.pipeline.centering().state().position
    }

    /// Switches the loop: on, or manual, where [`Bench::move_to`] moves the stage.
    pub fn switch(&mut self, mode: LoopMode) {
        self.params.mode = mode;
        let outcome = self.pipeline.centering().retune(self.params);
        self.send(outcome.command);
    }

    /// Sends the stage to a position; only in manual mode.
    ///
    /// # Errors
    /// The loop is not in manual mode.
    pub fn move_to(&mut self, position: StagePosition) -> Result<(), Failure> {
        let refused = |e: trifacet_core::centering::LoopRefusal| Failure::new(exit::SOFTWARE, e.to_string());
        self.pipeline.centering().move_to(position).map_err(refused)
    }

    /// Parks the stage, and closes the source. Returns the parking position, and why the stage has not
    /// acknowledged it; `None` if the loop never had the stage.
    pub async fn finish(mut self) -> Option<(StagePosition, Option<&'static str>)> {
        self.ending = true;
        let last = self.pipeline.centering().finish();
        if let Some(last) = last {
            self.driver.steer(last);
        }
        let parked = match last {
            None => None,
            Some(Command { id, position, .. }) => {
                let acknowledged = async {
                    while self.last_ack.is_none_or(|ack| ack.id != id) {
                        // Without samples there are no acknowledgements either: the time limit ends the wait.
                        if self.next().await.is_err() {
                            std::future::pending::<()>().await;
                        }
                    }
                };
                let complaint = match timeout(LAST_ACK, acknowledged).await {
                    Ok(()) if self.last_ack.is_some_and(|ack| ack.accepted) => None,
                    Ok(()) => Some("it refused this command"),
                    Err(_) => Some("it did not acknowledge this"),
                };
                Some((position, complaint))
            }
        };
        self.source.close().await;
        parked
    }

    fn take(&mut self, event: SourceEvent) -> Result<Option<RawSample>, Failure> {
        match event {
            SourceEvent::Up(identity) => self.up(identity).map(|()| None),
            SourceEvent::Ack(ack) => {
                self.outputs.answers.send_modify(|answers| answers.ack = Some(ack));
                Ok(None)
            }
            SourceEvent::Down(down) => {
                self.source_trouble = Some(down.to_string());
                let now = self.clock.now();
                let _ = self.pipeline.silence(now); // the loop notices; there is no command
                Ok(None)
            }
            SourceEvent::Scan(scan) => Ok(self.scan(&scan)),
        }
    }

    fn up(&mut self, identity: Identity) -> Result<(), Failure> {
        let identity = Arc::new(identity);
        self.pipeline.source(Arc::clone(&identity), self.clock.now())?;
        self.raw.source(Arc::clone(&identity))?;
        self.steps = Steps::new(&self.raw_channels, &identity);
        self.recorder.source(Arc::clone(&identity));
        self.outputs.answers.send_modify(|answers: &mut Answers| answers.source = Some(identity));
        Ok(())
    }

    fn scan(&mut self, scan: &Scan) -> Option<RawSample> {
        (self.deadline, self.source_trouble) = (Instant::now() + SILENCE, None);
        let Self { pipeline, recorder, records, clock, .. } = self;
        let step = pipeline.scan_with(scan, clock.now(), |step, estimation| {
            if let Some(transition) = step.transition {
                records.put(|| Entry::lock(scan.time, transition));
            }
            if let Some(sample) = &step.sample {
                recorder.sample(sample, *scan, &step.state, estimation.memory());
            }
        })?;
        self.send(step.command);
        if let Some(report) = &step.report {
            self.record_frame(report);
        }
        let sample = self.raw.sample(scan)?;
        Some(RawSample {
            time: sample.time,
            spots: sample.spots,
            powers: sample.powers,
            stage: sample.steering.or(self.reported.map(Into::into)),
            flaw: Flaw::of(&sample, step.state.lock),
        })
    }

    fn record_frame(&mut self, report: &PoseReport) {
        let PoseReport { time, config, covariance, .. } = *report;
        let sequence = self.frames;
        self.frames += 1;
        self.records.put(|| {
            let stamp = Stamp { session: 0, config, sequence, time_ns: time.0, synced: false, sent: time };
            Entry::Frame { frame: report.frame(stamp), time, covariance }
        });
    }

    fn send(&mut self, command: Option<Command>) {
        if let Some(command) = command {
            self.driver.steer(command);
        }
    }

    fn hear(&mut self, event: StageEvent) {
        match event {
            StageEvent::Up => {
                self.stage_trouble = None;
                self.pipeline.centering().stage_up();
            }
            StageEvent::At(position) => {
                self.reported = Some(position);
                self.pipeline.centering().stage_at(position);
            }
            StageEvent::Down(reason) => {
                self.stage_trouble = Some(format!("the stage takes no commands: {reason}"));
                self.pipeline.centering().stage_down();
            }
            StageEvent::Ack(ack) => {
                self.last_ack = Some(ack);
                self.pipeline.centering().stage_answers(ack);
            }
        }
    }
}

/// Whether a sample lies on the apex or under manual control of the stage.
pub fn usable(sample: &RawSample, manual: bool) -> bool {
    match sample.flaw {
        None => true,
        Some(Flaw::NotLocked(LockState::Manual)) => manual,
        Some(_) => false,
    }
}
