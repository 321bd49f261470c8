//! The closed loop without clocks: the twin and the cores of all three tasks, scan after scan, as fast as
//! they are called. The same configuration gives the same results, bit by bit.
//!
//! As in the daemon, the channel map converts a scan, centering acts on it, and estimation solves it. The
//! command takes effect after the delay of the stage; computing takes no time.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use trifacet_core::centering::lock::Transition;
use trifacet_core::centering::{Centering, LoopState};
use trifacet_core::estimation::PoseReport;
use trifacet_core::pipeline::{Pipeline, Step};
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

/// The twin with the daemon's cores.
#[derive(Clone, Debug)]
pub struct ClosedLoopSim {
    twin: Twin,
    outputs: Outputs,
    pipeline: Pipeline,
    /// Position of the stage at the full-scale code, metres.
    full_scale: f64,
    lost: u32,
    context: Arc<CalibrationContext>,
    recorder: EstimationRecorder,
    records: RecordSender,
    /// Number of reports so far.
    reports: u64,
}

/// One scan, and its results.
#[derive(Clone, Copy, Debug)]
pub struct SimStep {
    /// The scan, with the true state.
    pub scan: TwinScan,
    /// The sample of what arrived of it.
    pub sample: Option<Sample>,
    /// The command for the stage.
    pub command: Option<Command>,
    /// The change of the lock state, if it changed.
    pub transition: Option<Transition>,
    /// State of the loop after this step.
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
        let twin = Twin::new(config).map_err(|e| wrong(e.to_string()))?;
        let mut pipeline = config.pipeline(&context)?;
        let identity = Arc::new(twin.identity().clone());
        pipeline.source(identity, Mono(0))?;
        Ok(Self {
            outputs: twin.outputs().clone(),
            twin,
            pipeline,
            full_scale: config.steering.full_scale_um * 1e-6,
            lost: 0,
            recorder: EstimationRecorder::new(RecordSender::default(), Arc::clone(&context)),
            context,
            records: RecordSender::default(),
            reports: 0,
        })
    }

    /// The same with a record of everything, as in the daemon, and the receiver of the records, which must be
    /// emptied after each step. UTC is the time of the twin, which starts in 1970.
    ///
    /// # Errors
    /// The configuration has an error that would keep the daemon from starting.
    pub fn recorded(config: &Config) -> Result<(Self, RecordReceiver), Failure> {
        let mut sim = Self::new(config)?;
        let (records, receiver) = RecordSender::new(Arc::default());
        receiver.open.store(true, Ordering::Relaxed);
        sim.recorder = EstimationRecorder::new(records.clone(), Arc::clone(&sim.context));
        sim.recorder.source(Arc::new(sim.twin.identity().clone()));
        sim.records = records;
        Ok((sim, receiver))
    }

    /// The loop, for requests.
    pub fn centering(&mut self) -> &mut Centering {
        self.pipeline.centering()
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

    /// Takes the next scan, and does what the daemon would do.
    pub fn step(&mut self) -> SimStep {
        let time = Mono((self.twin.next_s() * NS_PER_S as f64).round() as i64);
        if self.outputs.expire(time) == Some(LeaseAction::Park) {
            self.twin.steer(self.outputs.park(), self.twin.next_s());
        }
        let scan = self.twin.next_scan();
        let step = if let Some(arrived) = scan.arrived(time, self.lost) {
            self.lost = 0;
            self.scan(&arrived)
        } else {
            self.lost += 1;
            self.silence(time)
        };
        let state = self.pipeline.centering().state();
        let nothing = Step { sample: None, command: None, transition: None, state, report: None };
        let Step { sample, command, transition, state, report } = step.unwrap_or(nothing);
        if let Some(command) = command {
            self.steer(command, scan.t_s, time);
        }
        if let Some(report) = &report {
            self.record_frame(report);
        }
        SimStep { scan, sample, command, transition, state, report }
    }

    fn scan(&mut self, scan: &Scan) -> Option<Step> {
        let Self { pipeline, recorder, records, .. } = self;
        pipeline.scan_with(scan, scan.time, |step, estimation| {
            record_transition(records, scan.time, step.transition);
            if let Some(sample) = &step.sample {
                recorder.sample(sample, *scan, &step.state, estimation.memory());
            }
        })
    }

    fn silence(&mut self, now: Mono) -> Option<Step> {
        let Self { pipeline, recorder, records, .. } = self;
        pipeline.silence_with(now, |step, estimation| {
            record_transition(records, now, step.transition);
            recorder.silence(now, &step.state, None, estimation.memory());
        })
    }

    fn record_frame(&mut self, report: &PoseReport) {
        let PoseReport { time, config, covariance, .. } = *report;
        let sequence = self.reports;
        self.reports += 1;
        self.records.put(|| {
            let stamp = Stamp { session: 0, config, sequence, time_ns: time.0, synced: true, sent: time };
            Entry::Frame { frame: report.frame(stamp), time, covariance }
        });
    }

    fn steer(&mut self, command: Command, t_s: f64, time: Mono) {
        let codes = codes(command.position, self.full_scale, OUTPUT_BITS);
        let Command { id, lease_ms, on_expiry, .. } = command;
        let accepted = self.outputs.take(&OutputCommand { id, codes, lease_ms, on_expiry }, time);
        if accepted {
            self.twin.steer(codes, t_s);
        }
        if let Some(id) = self.twin.acknowledged(id) {
            self.pipeline.centering().stage_answers(Ack { id, accepted });
        }
    }
}

fn record_transition(records: &RecordSender, time: Mono, transition: Option<Transition>) {
    if let Some(transition) = transition {
        records.put(|| Entry::lock(time, transition));
    }
}
