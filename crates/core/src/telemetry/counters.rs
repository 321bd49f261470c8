//! Counters: one place for every loss, so that no loss is silent.

use std::sync::atomic::{AtomicU64, Ordering};

use trifacet_wire::LockState;

macro_rules! counters {
    ($($(#[doc = $doc:literal])* $name:ident),* $(,)?) => {
        /// Every counter of the daemon. Shared, lock-free; each only ever grows.
        #[derive(Debug, Default)]
        pub struct Counters { $($(#[doc = $doc])* pub $name: Counter),* }

        impl Counters {
            /// What each of them counts, in the order of [`Counters::list`].
            pub const MEANINGS: &[&str] = &[$(concat!($($doc),*).trim_ascii()),*];

            /// All of them by name, in the order of the flow.
            pub fn list(&self) -> Vec<(&'static str, u64)> {
                vec![$((stringify!($name), self.$name.get())),*]
            }
        }
    };
}

counters! {
    /// Scans that arrived complete.
    scans,
    /// Samples that the converter took but that did not arrive.
    scans_lost,
    /// Frames of the board that arrived twice.
    scans_repeated,
    /// Frames of the board that arrived after a newer one and were not used.
    scans_late,
    /// Frames of the board with wrong framing or a wrong checksum.
    frames_corrupted,
    /// Undamaged frames of the board with invalid contents.
    frames_unknown,
    /// Frames of the daemon that the board did not understand.
    board_errors,
    /// Times the board read its converter too late.
    converter_overruns,
    /// Times the board held or parked the steering because no new command arrived in time.
    leases_expired,
    /// Times the source went down.
    source_downs,
    /// Times the replay reached the end of the recording.
    replay_ends,
    /// Gaps in the replayed recording: damaged or missing data.
    replay_holes,
    /// Steering commands passed to the source.
    commands_sent,
    /// Steering commands that the board refused.
    commands_refused,
    /// Samples dropped because estimation lagged behind.
    estimation_overflows,
    /// Samples that the controller did not act on: a newer one was available, or they arrived later than the
    /// loop delay of its gains.
    centering_skips,
    /// Times the loop began to acquire.
    lock_acquiring,
    /// Times the loop locked.
    lock_locked,
    /// Times the stage reached a limit.
    lock_railed,
    /// Times the loop began to hold the stage.
    lock_held,
    /// Times the beam was lost.
    lock_lost,
    /// Times a search began.
    lock_searching,
    /// Times the loop was switched off or to manual.
    lock_released,
    /// Pose frames made.
    frames,
    /// Pose frames without a valid pose.
    frames_invalid,
    /// Datagrams that the network stack did not accept.
    udp_dropped,
    /// Frames that did not reach the TCP server because it lagged behind.
    tcp_overflows,
    /// Frames dropped for TCP clients that were too slow, summed over clients.
    tcp_dropped,
    /// Requests for UDP subscriptions that were refused or invalid.
    udp_refused,
    /// TCP clients that were accepted.
    tcp_connected,
    /// TCP clients that have disconnected.
    tcp_disconnected,
    /// TCP clients that were refused: too many, or not from an allowed network.
    tcp_refused,
    /// Entries that did not reach the recorder because it lagged behind.
    recording_overflows,
    /// Entries lost because the file could not be written.
    recording_lost,
    /// Messages written to recordings.
    recording_messages,
    /// Bytes written to recordings.
    recording_bytes,
    /// Recordings begun.
    recording_files,
    /// Recordings deleted to keep the budget.
    recording_deletions,
    /// Times a recording could not continue: disk full, folder missing, or similar.
    recording_faults,
    /// Frames that did not reach the monitor because it lagged behind.
    monitor_overflows,
    /// Updates of the page, each made once for all viewers.
    page_updates,
    /// Updates of the page that a viewer did not accept in time, summed over viewers.
    page_skips,
    /// HTTP connections that were closed and viewers that were refused: too many.
    monitor_refused,
    /// HTTP requests that were refused: not addressed to this host alone, or from a page of another host.
    monitor_forbidden,
    /// Commands over HTTP that were refused: a wrong token, or monitor.control is off.
    monitor_denied,
}

impl Counters {
    /// That of the times the loop came to this state.
    pub fn lock(&self, state: LockState) -> &Counter {
        match state {
            LockState::Acquiring => &self.lock_acquiring,
            LockState::Locked => &self.lock_locked,
            LockState::Railed => &self.lock_railed,
            LockState::Held => &self.lock_held,
            LockState::Lost => &self.lock_lost,
            LockState::Searching => &self.lock_searching,
            LockState::Off | LockState::Manual => &self.lock_released,
        }
    }
}

/// A number that only grows.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// Counts one more.
    pub fn inc(&self) {
        self.add(1);
    }

    /// Counts `n` more.
    pub fn add(&self, n: u64) {
        self.0.fetch_add(n, Ordering::Relaxed);
    }

    /// The count so far.
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}
