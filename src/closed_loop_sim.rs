//! The closed loop without clocks: the twin and the cores of all three tasks, scan after scan, as fast as
//! they are called. The same configuration gives the same results, bit by bit.
//!
//! As in the daemon, the channel map converts a scan, centering acts on it, and estimation solves it. The
//! command takes effect after the delay of the stage; computing takes no time.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use trifacet_core::centering::lock::Transition;
use trifacet_core::centering::{Centering, LoopState, Outcome, TimedPose};
use trifacet_core::channels::ChannelMap;
use trifacet_core::estimation::{Estimation, PoseReport};
use trifacet_core::signals::{Sample, Scan};
use trifacet_core::stamp::Stamp;
use trifacet_core::steering::{Command, codes};
use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_optics::Pose;
use trifacet_wire::actuator::{Ack, LeaseAction, OutputCommand};

use crate::config::{CalibrationContext, Config, FaultKind};
use crate::exit::{self, Failure};
use crate::recording::entry::RecordReceiver;
use crate::recording::{Entry, EstimationRecorder, RecordSender};
use crate::twin::{OUTPUT_BITS, Outputs, Twin, TwinError, TwinScan};

/// Silence is detected after this time, and again after each half of it, as in the daemon.
const SILENCE_TIMEOUT_S: f64 = 0.02;

/// The twin with the cores of the daemon.
#[derive(Clone, Debug)]
pub struct ClosedLoopSim {
    twin: Twin,
    outputs: Outputs,
    channels: ChannelMap,
    centering: Centering,
    estimation: Estimation,
    /// Position of the stage at the full-scale code, metres.
    full_scale: f64,
    pose: Option<TimedPose>,
    lost: u32,
    context: Arc<CalibrationContext>,
    recorder: EstimationRecorder,
    records: RecordSender,
    /// Number of reports so far.
    reports: u64,
    /// Time at which silence is detected next, and time since which it counts, seconds.
    silence_s: [f64; 2],
}

/// One scan, and its results.
#[derive(Clone, Copy, Debug)]
pub struct SimStep {
    /// The scan, with the true state.
    pub scan: TwinScan,
    /// The sample, if the scan arrived.
    pub sample: Option<Sample>,
    /// The command for the stage.
    pub command: Option<Command>,
    /// The change of the lock state, if there is one.
    pub transition: Option<Transition>,
    /// State of the loop after this scan.
    pub state: LoopState,
    /// The report that the daemon would publish.
    pub report: Option<PoseReport>,
}

impl ClosedLoopSim {
    /// A simulation at rest.
    ///
    /// # Errors
    /// The configuration has an error that would keep the daemon from starting.
    pub fn new(config: &Config) -> Result<Self, Failure> {
        let wrong = |message: String| Failure::new(exit::CONFIG, message);
        let context = Arc::new(CalibrationContext::read(config.clone()).map_err(|e| wrong(e.to_string()))?);
        let channels = config.channels(&context.tables)?;
        let (calibrated, id) = (channels.calibrated(), context.id());
        let settings = config.estimation_settings(calibrated, id).map_err(|e| wrong(e.to_string()))?;
        let twin = Twin::new(config).map_err(|e| wrong(e.to_string()))?;
        let mut estimation = Estimation::new(settings);
        estimation.source(true);
        Ok(Self {
            outputs: twin.outputs().clone(),
            channels: channels.map(twin.identity()).map_err(|e| wrong(e.to_string()))?,
            twin,
            centering: config.centering_loop().map_err(|e| wrong(e.to_string()))?,
            estimation,
            full_scale: config.steering.full_scale_um * 1e-6,
            pose: None,
            lost: 0,
            recorder: EstimationRecorder::new(RecordSender::default(), Arc::clone(&context)),
            context,
            records: RecordSender::default(),
            reports: 0,
            silence_s: [SILENCE_TIMEOUT_S, 0.0],
        })
    }

    /// The same with a record of everything, as in the daemon, and the receiver of the records, which must be
    /// emptied after each step. UTC is the time of the twin, which starts in 1970.
    ///
    /// # Errors
    /// The configuration has an error that would keep the daemon from starting.
    pub fn recorded(config: &Config) -> Result<(Self, RecordReceiver), Failure> {
        let mut rig = Self::new(config)?;
        let (records, receiver) = RecordSender::new(Arc::default());
        receiver.open.store(true, Ordering::Relaxed);
        rig.recorder = EstimationRecorder::new(records.clone(), Arc::clone(&rig.context));
        rig.recorder.source(Arc::new(rig.twin.identity().clone()));
        rig.records = records;
        Ok((rig, receiver))
    }

    /// The loop, for requests.
    pub fn centering(&mut self) -> &mut Centering {
        &mut self.centering
    }

    /// Injects a fault from the next scan on, for `for_s` seconds or, with `None`, without end.
    ///
    /// # Errors
    /// A value of the fault is out of range.
    pub fn inject(&mut self, kind: FaultKind, for_s: Option<f64>) -> Result<(), TwinError> {
        self.twin.inject(kind, for_s)
    }

    /// Holds the mirror at this pose from the next scan on, instead of its configured motion.
    pub fn place(&mut self, pose: Pose) {
        self.twin.place(pose);
    }

    /// Takes the next scan, and processes it as the daemon would.
    pub fn turn(&mut self) -> SimStep {
        let time = Mono((self.twin.next_s() * NS_PER_S as f64).round() as i64);
        if self.outputs.expire(time) == Some(LeaseAction::Park) {
            self.twin.steer(self.outputs.park(), self.twin.next_s());
        }
        let scan = self.twin.next_scan();
        if let Some(arrived) = scan.arrived(time, self.lost) {
            self.lost = 0;
            self.silence_s = [scan.t_s + SILENCE_TIMEOUT_S, scan.t_s];
            let sample = self.channels.sample(&arrived);
            self.sample(&scan, arrived, &sample)
        } else {
            self.lost += 1;
            self.silence(&scan, time)
        }
    }

    fn sample(&mut self, scan: &TwinScan, arrived: Scan, sample: &Sample) -> SimStep {
        let Outcome { command, transition, .. } =
            self.centering.sample(sample, self.pose.as_ref(), sample.time);
        if let Some(command) = command {
            self.steer(command, scan.t_s, sample.time);
        }
        let state = self.centering.state();
        self.changed(sample.time, transition);
        self.recorder.sample(sample, arrived, &state, self.estimation.memory());
        let report = self.estimation.sample(sample, &state);
        if let Some(PoseReport { pose, time, .. }) = report {
            self.pose = pose.map(|pose| TimedPose { pose, time });
        }
        SimStep {
            scan: *scan,
            sample: Some(*sample),
            command,
            transition,
            state,
            report: report.map(|report| self.published(&report)),
        }
    }

    fn silence(&mut self, scan: &TwinScan, time: Mono) -> SimStep {
        let [due, since] = self.silence_s;
        let mut turn = SimStep {
            scan: *scan,
            sample: None,
            command: None,
            transition: None,
            state: self.centering.state(),
            report: None,
        };
        if scan.t_s >= due {
            self.silence_s = [scan.t_s + SILENCE_TIMEOUT_S / 2.0, scan.t_s];
            self.pose = None;
            turn.transition = self.centering.silence(scan.t_s - since);
            turn.state = self.centering.state();
            self.changed(time, turn.transition);
            self.recorder.silence(time, &turn.state, None, self.estimation.memory());
            let report = self.estimation.silence(time, &turn.state);
            turn.report = Some(self.published(&report));
        }
        turn
    }

    fn published(&mut self, report: &PoseReport) -> PoseReport {
        let report = self.estimation.in_user_frame(report);
        let PoseReport { time, config, covariance, .. } = report;
        let sequence = self.reports;
        self.reports += 1;
        self.records.put(|| {
            let stamp = Stamp { session: 0, config, sequence, time_ns: time.0, synced: true, sent: time };
            Entry::Frame { frame: report.frame(stamp), time, covariance }
        });
        report
    }

    fn changed(&self, time: Mono, transition: Option<Transition>) {
        if let Some(Transition { from, to, cause }) = transition {
            self.records.put(|| Entry::Lock { time, before: from, after: to, cause: cause.into() });
        }
    }

    fn steer(&mut self, command: Command, t_s: f64, time: Mono) {
        let codes = codes(command.position, self.full_scale, OUTPUT_BITS);
        let Command { id, lease_ms, on_expiry, .. } = command;
        let accepted = self.outputs.take(&OutputCommand { id, codes, lease_ms, on_expiry }, time);
        if accepted {
            self.twin.steer(codes, t_s);
        }
        self.centering.stage_answers(Ack { id, accepted });
    }
}
