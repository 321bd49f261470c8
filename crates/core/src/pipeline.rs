//! The pipeline: a scan and the present moment in; a pose report, a command and a change of the lock state out. Pure.
//!
//! ```text
//!                     ┌─> centering ──> command for the stage
//! scan ──> mapping ───┤       │ loop state      ^ pose of the report before
//!                     └─> estimation ──> report, in the user's frame
//! ```
//!
//! [`Pipeline`] runs the three parts one after the other, with computing that takes no time: so simulations use it.
//! The daemon takes it apart ([`Pipeline::into_parts`]) and runs each part in a task of its own, in the same order.
//! [`Measurement`] is the pipeline without centering: it repeats a recording, in which the loop state is given.
//!
//! ```
//! use std::time::Duration;
//!
//! use trifacet_core::centering::{Centering, LoopParams};
//! use trifacet_core::channels::Channels;
//! use trifacet_core::estimation::{Estimation, Settings};
//! use trifacet_core::pipeline::{Mapping, Measurement, Pipeline};
//! use trifacet_core::signals::{Identity, Scan};
//! use trifacet_core::time::Mono;
//! use trifacet_optics::{Head, Model, Optics};
//!
//! let optics = Optics::new(&Head::default());
//! let estimation = Estimation::new(Settings::new(optics.clone(), Model::Gaussian));
//! let measurement = Measurement { mapping: Mapping::new(Channels::default()), estimation };
//! let (centering, silence) = (Centering::new(LoopParams::default(), optics), Duration::from_millis(20));
//! let mut pipeline = Pipeline::new(measurement, centering, silence);
//!
//! let identity = Identity::example(); // a board with nine channels, +-10 V in 16 bits
//! let time = Mono(0);
//! pipeline.source(identity.into(), time)?;
//! let mut codes = [0; 16];
//! [codes[2], codes[5], codes[8]] = [13_000; 3]; // 4 V on each sum signal, every spot at the centre of its PSD
//! let scan = Scan { index: 0, time, time_sigma_ns: None, lost: 0, codes, output_railed: false, applied: None };
//! let step = pipeline.scan(&scan, time).expect("the source is up");
//! let pose = step.report.and_then(|report| report.pose).expect("all three PSDs see light");
//! assert!(pose.t.norm() < 1e-3, "{pose:?}"); // metres
//! # Ok::<(), trifacet_core::channels::MissingSignal>(())
//! ```

use std::sync::Arc;
use std::time::Duration;

use trifacet_wire::channel::Role;

use crate::centering::lock::Transition;
use crate::centering::{Centering, LoopState, TimedPose};
use crate::channels::{ChannelMap, Channels, MissingSignal};
use crate::estimation::{Estimation, PoseReport};
use crate::signals::{Identity, Sample, Scan};
use crate::steering::Command;
use crate::time::Mono;

/// A silence is this many sampling periods at least.
const PERIODS_OF_SILENCE: f64 = 5.0;
/// Reports per second during a silence, at most.
const SILENCE_HZ: f64 = 100.0;

/// When the lack of samples is reported, for a source of a given rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SilenceTimes {
    /// From the last sample to the first report.
    pub first: Duration,
    /// From each report to the next.
    pub repeat: Duration,
}

impl SilenceTimes {
    /// The times for samples at `rate_hz`. `shortest` is the shortest silence that is reported.
    pub fn new(rate_hz: f64, shortest: Duration) -> Self {
        Self {
            first: shortest.max(Duration::from_secs_f64(PERIODS_OF_SILENCE / rate_hz)),
            repeat: Duration::from_secs_f64(1.0 / rate_hz.min(SILENCE_HZ)),
        }
    }
}

/// The first part: the scans of a source to samples.
#[derive(Clone, Debug)]
pub struct Mapping {
    channels: Channels,
    source: Option<(Arc<Identity>, ChannelMap)>,
}

impl Mapping {
    /// A mapping without a source.
    pub fn new(channels: Channels) -> Self {
        Self { channels, source: None }
    }

    /// A source is up. A source that is refused leaves the one before in place.
    ///
    /// # Errors
    /// The source lacks one of the nine signals.
    pub fn source(&mut self, identity: Arc<Identity>) -> Result<(), MissingSignal> {
        let map = self.channels.map(&identity)?;
        self.source = Some((identity, map));
        Ok(())
    }

    /// The source that came up last.
    pub fn identity(&self) -> Option<&Arc<Identity>> {
        self.source.as_ref().map(|(identity, _)| identity)
    }

    /// From the next scan on, other channel parameters apply.
    pub fn set_channels(&mut self, channels: Channels) {
        if let Some((_, map)) = &mut self.source {
            map.retune(channels.clone());
        }
        self.channels = channels;
    }

    /// Takes a scan as the one before the next, without a sample of it.
    pub fn follow(&mut self, scan: &Scan) {
        if let Some((_, map)) = &mut self.source {
            map.follow(scan);
        }
    }

    /// The signals whose channels repeat the same code although they have noise.
    pub fn frozen(&self) -> impl Iterator<Item = Role> {
        self.source.iter().flat_map(|(_, map)| map.frozen())
    }

    /// The sample of a scan; `None` without a source.
    pub fn sample(&mut self, scan: &Scan) -> Option<Sample> {
        self.source.as_mut().map(|(_, map)| map.sample(scan))
    }
}

/// Mapping and estimation: the pipeline without centering.
#[derive(Clone, Debug)]
pub struct Measurement {
    /// Scans to samples.
    pub mapping: Mapping,
    /// Samples to reports.
    pub estimation: Estimation,
}

impl Measurement {
    /// A source is up.
    ///
    /// # Errors
    /// The source lacks one of the nine signals.
    pub fn source(&mut self, identity: Arc<Identity>) -> Result<(), MissingSignal> {
        self.mapping.source(Arc::clone(&identity))?;
        self.estimation.source(identity);
        Ok(())
    }

    /// The report of a sample, in the user's frame; `None` within a block that is averaged.
    pub fn sample(&mut self, sample: &Sample, state: &LoopState) -> Option<PoseReport> {
        let report = self.estimation.sample(sample, state)?;
        Some(self.estimation.in_user_frame(&report))
    }

    /// The report of a moment without samples, in the user's frame.
    pub fn silence(&mut self, now: Mono, state: &LoopState) -> PoseReport {
        let report = self.estimation.silence(now, state);
        self.estimation.in_user_frame(&report)
    }
}

/// Mapping, centering and estimation, run one after the other.
#[derive(Clone, Debug)]
pub struct Pipeline {
    measurement: Measurement,
    centering: Centering,
    pose: Option<TimedPose>,
    /// The shortest silence that is reported.
    shortest: Duration,
    /// The times of silence of the source that is up.
    times: Option<SilenceTimes>,
    /// When the next silence is due, and since when it counts.
    silence: Option<(Mono, Mono)>,
}

/// What comes out of a scan or a silence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The sample of the scan; `None` in a silence.
    pub sample: Option<Sample>,
    /// The command for the stage, if the loop has one.
    pub command: Option<Command>,
    /// The change of the lock state, if it changed.
    pub transition: Option<Transition>,
    /// State of the loop after this step.
    pub state: LoopState,
    /// The report, in the user's frame; `None` within a block that is averaged.
    pub report: Option<PoseReport>,
}

impl Pipeline {
    /// A pipeline at rest, without a source. `silence` is the shortest silence that is reported.
    pub fn new(measurement: Measurement, centering: Centering, silence: Duration) -> Self {
        Self { measurement, centering, pose: None, shortest: silence, times: None, silence: None }
    }

    /// The three parts, for three tasks.
    pub fn into_parts(self) -> (Mapping, Centering, Estimation) {
        let Measurement { mapping, estimation } = self.measurement;
        (mapping, self.centering, estimation)
    }

    /// A source is up at the moment `now`.
    ///
    /// # Errors
    /// The source lacks one of the nine signals.
    pub fn source(&mut self, identity: Arc<Identity>, now: Mono) -> Result<(), MissingSignal> {
        let times = SilenceTimes::new(identity.rate_hz, self.shortest);
        self.measurement.source(identity)?;
        self.times = Some(times);
        self.silence = self.due(now, |times| times.first);
        Ok(())
    }

    /// The loop, to steer it by hand and to report what the stage does.
    pub fn centering(&mut self) -> &mut Centering {
        &mut self.centering
    }

    /// Takes a scan at the moment `now`; `None` without a source.
    pub fn scan(&mut self, scan: &Scan, now: Mono) -> Option<Step> {
        self.scan_with(scan, now, |_, _| {})
    }

    /// As [`scan`](Self::scan). `before_estimation` sees the step so far, without its report, and estimation as it
    /// is before it takes the sample: for a recorder.
    pub fn scan_with(
        &mut self,
        scan: &Scan,
        now: Mono,
        before_estimation: impl FnOnce(&Step, &Estimation),
    ) -> Option<Step> {
        let sample = self.measurement.mapping.sample(scan)?;
        self.silence = self.due(now, |times| times.first);
        let outcome = self.centering.sample(&sample, self.pose.as_ref(), now);
        let step = Step {
            sample: Some(sample),
            command: outcome.command,
            transition: outcome.transition,
            state: self.centering.state(),
            report: None,
        };
        before_estimation(&step, &self.measurement.estimation);
        let report = self.measurement.estimation.sample(&sample, &step.state);
        if let Some(PoseReport { pose, time, .. }) = report {
            self.pose = pose.map(|pose| TimedPose { pose, time });
        }
        Some(Step { report: report.map(|report| self.measurement.estimation.in_user_frame(&report)), ..step })
    }

    /// No scan has come until `now`: a report of that, if it is due.
    pub fn silence(&mut self, now: Mono) -> Option<Step> {
        self.silence_with(now, |_, _| {})
    }

    /// As [`silence`](Self::silence), with `before_estimation` as in [`scan_with`](Self::scan_with).
    pub fn silence_with(
        &mut self,
        now: Mono,
        before_estimation: impl FnOnce(&Step, &Estimation),
    ) -> Option<Step> {
        let (_, since) = self.silence.filter(|(due, _)| now >= *due)?;
        self.silence = self.due(now, |times| times.repeat);
        self.pose = None;
        let transition = self.centering.silence(now.seconds_since(since));
        let step =
            Step { sample: None, command: None, transition, state: self.centering.state(), report: None };
        before_estimation(&step, &self.measurement.estimation);
        let report = Some(self.measurement.silence(now, &step.state));
        Some(Step { report, ..step })
    }

    fn due(&self, now: Mono, wait: impl FnOnce(&SilenceTimes) -> Duration) -> Option<(Mono, Mono)> {
        let wait_ns = wait(self.times.as_ref()?).as_nanos() as i64;
        Some((now + wait_ns, now))
    }
}
