//! How long commands wait for frames. Frames can be rare: `estimation.average` and a divider make their period
//! any length. A limit is therefore three frame periods, but not less than [`SHORTEST`].

use std::io::{self, Write as _};
use std::time::Duration;

use tokio::time::{Instant, timeout_at};
use trifacet::client::{Client, ClientError, Endpoint, Message};

/// Shortest time without a frame that is reported. A connection by TCP carries a heartbeat every second, so
/// that the same time without any message is reported too.
pub(super) const SHORTEST: Duration = Duration::from_secs(3);
/// Time without a frame after which a command ends although the period is unknown, as over `udp://` before
/// the second frame: longer than a block of 60 000 samples at 1 kHz.
const UNKNOWN: Duration = Duration::from_secs(65);
/// Limit of the limit, so that no period can make a time overflow.
const LONGEST: Duration = Duration::from_hours(720);

/// A result of waiting.
pub(super) enum Heard {
    /// A message.
    Message(Message),
    /// No frame for this time.
    Silence {
        /// Time since the last frame, or since the beginning.
        waited: Duration,
        /// A frame or a heartbeat was due. Otherwise the period is unknown, and a frame may still come.
        due: bool,
    },
}

/// Waits for messages and reports silence.
pub(super) struct Wait {
    /// The period if the client does not know it.
    expected: Option<Duration>,
    /// Arrival of the last frame, or the beginning.
    last_frame: Instant,
    /// Arrival of the last message, or the last report of a silence.
    last_event: Instant,
    reported: bool,
}

impl Wait {
    /// Begins to wait. `expected` is the time between frames if the client does not know it.
    pub(super) fn new(expected: Option<Duration>) -> Self {
        let now = Instant::now();
        Self { expected, last_frame: now, last_event: now, reported: false }
    }

    /// The next message, or a silence.
    ///
    /// # Errors
    /// As [`Client::next`].
    pub(super) async fn next(&mut self, client: &mut Client, from: &Endpoint) -> Result<Heard, ClientError> {
        let limit = client
            .frame_period()
            .or(self.expected)
            .map(|period| period.saturating_mul(3).clamp(SHORTEST, LONGEST));
        let stream = matches!(from, Endpoint::Tcp(_));
        let frame_due = self.last_frame + limit.unwrap_or(SHORTEST);
        let end = match (self.reported, stream) {
            // Once more when waiting longer is of no use.
            (true, _) => (self.last_frame + UNKNOWN).max(self.last_event + SHORTEST),
            (false, true) => frame_due.min(self.last_event + SHORTEST),
            (false, false) => frame_due,
        };
        let heard = timeout_at(end, client.next()).await;
        self.last_event = Instant::now();
        let Ok(message) = heard else {
            self.reported = true;
            let waited = self.last_frame.elapsed();
            return Ok(Heard::Silence { waited, due: stream || waited >= limit.unwrap_or(UNKNOWN) });
        };
        let message = message?;
        match message {
            Message::Pose(_) => {
                if std::mem::take(&mut self.reported) {
                    // Frames are this rare, whatever is known of them.
                    self.expected = self.expected.max(Some(self.last_event - self.last_frame));
                }
                self.last_frame = self.last_event;
            }
            Message::Descriptor(_) => announce(client.frame_period()),
            _ => {}
        }
        Ok(Heard::Message(message))
    }
}

/// Tells an operator that the next frame takes long.
fn announce(period: Option<Duration>) {
    if let Some(period) = period.filter(|period| *period > SHORTEST) {
        note(&format!("a frame comes every {} s", period.as_secs_f64()));
    }
}

/// Prints a line to standard error, which may be closed.
pub(super) fn note(line: &str) {
    let _ = writeln!(io::stderr(), "trifacet: {line}");
}
