//! The thread of the recorder.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::sync::mpsc;
use trifacet_core::telemetry::Counters;

use super::Recorder;
use crate::config::{RecordingConfig, RecordingMode};
use crate::recording::RecordSender;
use crate::recording::disk::Disk;
use crate::recording::handle::{Handle, State};

/// Longest wait for the end of the recorder.
const END_TIMEOUT: Duration = Duration::from_secs(4);

/// The thread of the recorder.
#[derive(Debug)]
pub struct Thread {
    handle: JoinHandle<()>,
    ended: Receiver<()>,
    stop: Arc<AtomicBool>,
}

/// Starts the recorder. Returns the sender for entries, the interface, and the thread.
///
/// # Errors
/// A thread cannot be started.
pub fn start(
    config: &RecordingConfig,
    counters: &Arc<Counters>,
) -> std::io::Result<(RecordSender, Handle, Thread)> {
    let (records, receiver) = RecordSender::new(Arc::clone(counters));
    // Open before the first sample arrives.
    receiver.open.store(config.mode != RecordingMode::Off, Ordering::Relaxed);
    let (requests, asked) = mpsc::channel(4);
    let state = Arc::new(State::new(config.mode));
    let disk = Disk::start()?;
    let recorder =
        Recorder::new(config.clone(), receiver, asked, disk, Arc::clone(&state), Arc::clone(counters));
    let stop = Arc::clone(&recorder.stop);
    let (end, ended) = channel();
    let alarm = Alarm(Arc::clone(&state));
    let thread = std::thread::Builder::new().name("recorder".into()).spawn(move || {
        let _alarm = alarm;
        recorder.run();
        // A closed channel means that `join` has given up.
        let _ = end.send(());
    })?;
    Ok((records, Handle { state, requests }, Thread { handle: thread, ended, stop }))
}

impl Thread {
    /// Ends the recorder and waits until everything is on disk, for 4 s at most. To be called
    /// after the fast side has sent its last entry.
    pub fn join(self) {
        self.stop.store(true, Ordering::Relaxed);
        if self.ended.recv_timeout(END_TIMEOUT) == Err(RecvTimeoutError::Timeout) {
            tracing::error!("the disk is too slow to finish the recording: the file stays unfinished");
        } else if self.handle.join().is_err() {
            tracing::error!("the recorder panicked");
        }
    }
}

/// Reports a panic of the recorder as a fault, which frames carry.
struct Alarm(Arc<State>);

impl Drop for Alarm {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.file(None);
            self.0.fault(Some("the recorder has crashed: restart the daemon".into()));
            tracing::error!("the recorder has crashed, recording has stopped; restart the daemon");
        }
    }
}
