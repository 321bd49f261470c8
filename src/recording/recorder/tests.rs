//! Cases that a test with a whole daemon cannot produce.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use tokio::sync::{mpsc, oneshot};
use trifacet_core::centering::LoopState;
use trifacet_core::estimation::{Estimation, EstimatorState};
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Clock, Mono};

use super::Recorder;
use crate::clock::SystemClock;
use crate::config::{CalibrationContext, CalibrationState, Config, RecordingConfig, RecordingMode};
use crate::exit;
use crate::recording::disk::Disk;
use crate::recording::handle::{Asked, RecorderCommand, State};
use crate::recording::reader::Read;
use crate::recording::{Entry, EstimationRecorder, Reader, RecordSender};

/// A fast side that only reports silence.
struct Silent {
    recorder: EstimationRecorder,
    memory: EstimatorState,
    time: Mono,
}

impl Silent {
    fn says(&mut self) {
        self.time = self.time + 1_000_000;
        self.recorder.silence(self.time, &LoopState::default(), None, &self.memory);
    }
}

fn recorder(folder: &Path, mode: RecordingMode) -> (Recorder, Silent, mpsc::Sender<Asked>) {
    let counters = Arc::new(Counters::default());
    let (records, receiver) = RecordSender::new(Arc::clone(&counters));
    let config = Config::default();
    let memory = Estimation::new(config.estimation_settings(&CalibrationState::default(), 3).unwrap())
        .memory()
        .clone();
    let context = Arc::new(CalibrationContext { config, ..CalibrationContext::default() });
    let config = RecordingConfig { folder: folder.to_owned(), mode, ..Default::default() };
    let state = Arc::new(State::new(config.mode));
    let (requests, asked) = mpsc::channel(1);
    let recorder = Recorder::new(config, receiver, asked, Disk::start().unwrap(), state, counters);
    let fast =
        Silent { recorder: EstimationRecorder::new(records, context), memory, time: SystemClock.now() };
    (recorder, fast, requests)
}

/// Silences before the gap, the gaps, and silences after them.
fn content(path: &Path) -> (usize, Vec<(u64, String)>, usize) {
    let mut reader = Reader::open(path, Reader::REPLAY).unwrap();
    let (mut before, mut gaps, mut after) = (0, Vec::new(), 0);
    while let Some(read) = reader.read().unwrap() {
        match read {
            Read::Gap { entries, reason } => gaps.push((entries, reason)),
            Read::Entry(Entry::Silence { .. }) if gaps.is_empty() => before += 1,
            Read::Entry(Entry::Silence { .. }) => after += 1,
            _ => {}
        }
    }
    (before, gaps, after)
}

#[test]
fn entries_lost_at_a_full_queue_are_counted_and_recorded_as_a_gap() {
    for mode in [RecordingMode::Always, RecordingMode::OnFault] {
        let folder = tempfile::tempdir().unwrap();
        let (mut recorder, mut fast, _) = recorder(folder.path(), mode);
        recorder.drain();
        let lost = loop {
            fast.says(); // and the recorder does not drain the queue
            let lost = recorder.counters.recording_overflows.get();
            if lost > 500 {
                break lost;
            }
        };
        while !recorder.receiver.entries.is_empty() {
            recorder.drain();
        }
        recorder.mind(SystemClock.now());
        assert!(recorder.state.fault.load(Ordering::Relaxed));
        fast.says();
        recorder.drain();
        if mode == RecordingMode::OnFault {
            recorder.triggered("requested").unwrap();
            recorder.empty_ring();
        }
        recorder.output.as_mut().unwrap().flush().unwrap();
        let (before, gaps, after) = content(&recorder.output.as_ref().unwrap().path);
        let [(entries, reason)] = gaps.as_slice() else { panic!("{gaps:?}") };
        assert!(*entries == lost && reason.contains("behind"), "{entries} of {lost}: {reason}");
        assert!(before > 1000 && after == 1, "{before} before, {after} after");
    }
}

#[test]
fn a_failure_to_finish_an_old_file_is_reported_and_the_new_one_continues() {
    let folder = tempfile::tempdir().unwrap();
    let (mut recorder, mut fast, _) = recorder(folder.path(), RecordingMode::Always);
    recorder.drain();
    fast.says();
    recorder.drain();
    let old = recorder.output.as_ref().unwrap().path.clone();
    // The next file has begun before the disk thread has finished this one.
    let file = Arc::new(std::fs::File::open("/dev/null").unwrap());
    recorder.disk.close(file, old.with_extension("other"));
    recorder.disk.wait();
    recorder.hear_disk();
    assert!(recorder.output.is_some() && recorder.fault.is_none());
    assert!(recorder.state.fault.load(Ordering::Relaxed), "frames report the fault for a while");
    let later = SystemClock.now() + 2 * super::SECOND_NS;
    recorder.mind(later);
    assert!(!recorder.state.fault.load(Ordering::Relaxed));
}

#[test]
fn a_stop_waits_for_the_disk_and_a_fault_before_it_is_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let (mut recorder, mut fast, requests) = recorder(folder.path(), RecordingMode::OnFault);
    let stop = |recorder: &mut Recorder| {
        let (reply, answer) = oneshot::channel();
        requests.try_send((RecorderCommand::Stop, reply)).unwrap();
        recorder.obey();
        answer
    };
    recorder.drain();
    fast.says();
    recorder.drain();
    recorder.triggered("a fault").unwrap();
    recorder.empty_ring();
    let mut answer = stop(&mut recorder);
    recorder.triggered("another one").unwrap();
    recorder.mind(SystemClock.now());
    assert_eq!(answer.try_recv().unwrap().unwrap_err().code, exit::DATA);
    assert!(recorder.output.is_some(), "recording continues");
    let mut answer = stop(&mut recorder);
    recorder.mind(SystemClock.now());
    assert!(answer.try_recv().is_err() && recorder.output.is_some(), "not before the next keyframe");
    fast.says();
    recorder.drain();
    let begins = recorder.ring.as_ref().and_then(super::Ring::begin_ns);
    assert!(recorder.output.is_none() && begins.is_some(), "the ring begins with the same keyframe");
    recorder.disk.wait();
    recorder.mind(SystemClock.now());
    // Only silence was recorded: the file is removed.
    answer.try_recv().unwrap().unwrap();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
