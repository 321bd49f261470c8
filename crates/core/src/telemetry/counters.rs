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
    /// Scans that arrived whole.
    scans,
    /// Samples that the converter took and that never arrived.
    scans_lost,
    /// Frames of the board that arrived twice.
    scans_repeated,
    /// Frames of the board that arrived after a younger one, and were not used.
    scans_late,
    /// Frames of the board whose framing or check sum was wrong.
    frames_corrupted,
    /// Frames of the board that were whole and made no sense.
    frames_unknown,
    /// Frames of the daemon that the board did not understand.
    board_errors,
    /// Times the board read its converter too late.
    converter_overruns,
    /// Times the board held or parked the steering because commands stopped coming in time.
    leases_expired,
    /// Times the source went down.
    source_downs,
    /// Times the recording that is replayed came to its end.
    replay_ends,
    /// Holes in the recording that is replayed: damage, or what was not recorded.
    replay_holes,
    /// Steering commands given to the source.
    commands_sent,
    /// Steering commands that the board refused.
    commands_refused,
    /// Samples dropped because estimation was behind.
    estimation_overflows,
    /// Samples the controller did not act on: a newer one was there, or they came later than the loop
    /// delay that its gains are made for.
    centering_skips,
    /// Times the loop began to acquire.
    lock_acquiring,
    /// Times the loop locked.
    lock_locked,
    /// Times the stage came to a limit.
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
    /// Datagrams that the network stack did not take.
    udp_dropped,
    /// Frames that never reached the TCP side because it was behind.
    tcp_overflows,
    /// Frames dropped for TCP clients that did not keep up, summed over clients.
    tcp_dropped,
    /// Requests for UDP subscriptions that were not granted, or were none.
    udp_refused,
    /// TCP clients that were let in.
    tcp_connected,
    /// TCP clients that have gone again.
    tcp_disconnected,
    /// TCP clients that were not let in: too many, or not of an allowed network.
    tcp_refused,
    /// Entries that never reached the recorder because it was behind.
    recording_overflows,
    /// Entries that are in no file because it could not be written.
    recording_lost,
    /// Messages written to recordings.
    recording_messages,
    /// Bytes written to recordings.
    recording_bytes,
    /// Recordings begun.
    recording_files,
    /// Recordings deleted because the budget was spent.
    recording_deletions,
    /// Times a recording could not go on: disk full, folder gone, or the like.
    recording_faults,
    /// Frames that never reached the monitor because it was behind.
    monitor_overflows,
    /// Updates of the page that were made, each once for all viewers.
    page_updates,
    /// Updates of the page that a viewer did not take in time, summed over viewers.
    page_skips,
    /// HTTP connections that were cut off, and viewers that were not let in: too many.
    monitor_refused,
    /// HTTP requests that were refused: not addressed to this host alone, or from a page of another.
    monitor_forbidden,
    /// Orders by HTTP that were refused: a wrong token, or monitor.control is off.
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
    pub fn one(&self) {
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
