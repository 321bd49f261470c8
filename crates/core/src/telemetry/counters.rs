//! Counters: one place for every loss, so that no loss is silent.

use std::sync::atomic::{AtomicU64, Ordering};

use trifacet_wire::LockState;

use crate::centering::lock::LockCause;

/// What a counter means for the user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CounterKind {
    /// An event of normal operation.
    Event,
    /// Something is lost, refused or too late: a sample, a frame, a command, a recorded entry.
    Loss,
}

/// The definition of a counter, which every surface reads: status, page, metrics, documentation.
#[derive(Clone, Copy, Debug)]
pub struct CounterDefinition {
    /// Its name.
    pub name: &'static str,
    /// Whether it counts losses.
    pub kind: CounterKind,
    /// What it counts, one sentence.
    pub meaning: &'static str,
}

macro_rules! counters {
    ($($(#[doc = $doc:literal])* $kind:ident $name:ident),* $(,)?) => {
        /// Every counter of the daemon. Shared, lock-free; each only ever grows.
        #[derive(Debug, Default)]
        pub struct Counters {
            $($(#[doc = $doc])* pub $name: Counter,)*
            /// Changes of the lock state by cause.
            causes: [Counter; LockCause::ALL.len()],
        }

        impl Counters {
            /// The definitions, in the order of the data flow.
            pub const DEFINITIONS: &[CounterDefinition] = &[$(CounterDefinition {
                name: stringify!($name),
                kind: CounterKind::$kind,
                meaning: concat!($($doc),*).trim_ascii(),
            }),*];

            /// The counts by name, in the order of [`Counters::DEFINITIONS`].
            pub fn list(&self) -> Vec<(&'static str, u64)> {
                vec![$((stringify!($name), self.$name.get())),*]
            }
        }
    };
}

counters! {
    /// Scans that arrived complete.
    Event scans,
    /// Samples that the converter took but that did not arrive.
    Loss scans_lost,
    /// Frames of the board that arrived twice.
    Event scans_repeated,
    /// Frames of the board that arrived after a newer one and were not used.
    Loss scans_late,
    /// Frames of the board with wrong framing or a wrong checksum.
    Loss frames_corrupted,
    /// Undamaged frames of the board with invalid contents.
    Loss frames_unknown,
    /// Bytes that arrived on the port of the board while it did not answer.
    Event bytes_foreign,
    /// Frames of the daemon that the board did not understand.
    Loss board_errors,
    /// Times the board read its converter too late.
    Loss converter_overruns,
    /// Times the board held or parked the steering because no new command arrived in time.
    Loss leases_expired,
    /// Faults of the board's clock: its tick disagrees with its sequence numbers or with the clock of the host.
    Event clock_faults,
    /// Restarts of the board that its boot id showed.
    Event board_restarts,
    /// Times the source went down.
    Loss source_downs,
    /// Times the replay reached the end of the recording.
    Event replay_ends,
    /// Gaps in the replayed recording: damaged or missing data.
    Loss replay_holes,
    /// Steering commands passed to the source.
    Event commands_sent,
    /// Steering commands that the board refused.
    Loss commands_refused,
    /// Steering commands that a newer one replaced before they were sent to the board.
    Event commands_replaced,
    /// Acknowledgements of commands that do not wait for one: of an unknown id, twice, or too late.
    Event acks_unknown,
    /// Samples dropped because estimation lagged behind.
    Loss estimation_overflows,
    /// Samples that the controller did not act on: a newer one was available, or they arrived later than the
    /// loop delay of its gains.
    Loss centering_skips,
    /// Times the loop began to acquire.
    Event lock_acquiring,
    /// Times the loop locked.
    Event lock_locked,
    /// Times the stage reached a limit.
    Event lock_railed,
    /// Times the loop began to hold the stage.
    Event lock_held,
    /// Times the beam was lost.
    Event lock_lost,
    /// Times a search began.
    Event lock_searching,
    /// Times the loop was switched off or to manual.
    Event lock_released,
    /// Pose frames made.
    Event frames,
    /// Pose frames without a valid pose.
    Event frames_invalid,
    /// Datagrams that the system refused, or accepted while the receiver could not be reached.
    Loss udp_dropped,
    /// Frames that did not reach the TCP server because it lagged behind.
    Loss tcp_overflows,
    /// Frames dropped for TCP clients that were too slow, summed over clients.
    Loss tcp_dropped,
    /// Requests for UDP subscriptions that were refused or invalid.
    Event udp_refused,
    /// TCP clients that were accepted.
    Event tcp_connected,
    /// TCP clients that have disconnected.
    Event tcp_disconnected,
    /// TCP clients that were refused: too many, or not from an allowed network.
    Event tcp_refused,
    /// Entries that did not reach the recorder because it lagged behind.
    Loss recording_overflows,
    /// Entries lost because the file could not be written.
    Loss recording_lost,
    /// Messages written to recordings.
    Event recording_messages,
    /// Bytes written to recordings.
    Event recording_bytes,
    /// Recordings begun.
    Event recording_files,
    /// Recordings deleted to keep the budget.
    Event recording_deletions,
    /// Times a recording could not continue: disk full, folder missing, or similar.
    Loss recording_faults,
    /// Frames that did not reach the monitor because it lagged behind.
    Loss monitor_overflows,
    /// Updates of the page, each made once for all viewers.
    Event page_updates,
    /// Updates of the page that a viewer did not accept in time, summed over viewers.
    Loss page_skips,
    /// HTTP connections that were closed and viewers that were refused: too many.
    Event monitor_refused,
    /// HTTP requests that were refused: not addressed to this host alone, or from a page of another host.
    Event monitor_forbidden,
    /// Commands over HTTP that were refused: a wrong token, or monitor.control is off.
    Event monitor_denied,
}

impl Counters {
    /// The names of the counters of losses.
    pub fn losses() -> impl Iterator<Item = &'static str> {
        Self::DEFINITIONS.iter().filter(|d| d.kind == CounterKind::Loss).map(|d| d.name)
    }

    /// Changes of the lock state with this cause.
    pub fn lock_cause(&self, cause: LockCause) -> &Counter {
        &self.causes[cause as usize]
    }

    /// The counter of transitions to this state.
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
