//! `trifacet watch`: prints the frames of a running daemon.

use std::io::{self, Write};
use std::ops::ControlFlow;
use std::time::Duration;

use anyhow::Result;
use clap::{Args, ValueEnum};
use tokio::time::{Instant, timeout};
use trifacet::client::{
    Backoff, Client, ClientError, Endpoint, Heartbeat, Losses, Message, Options, Pace, PoseFrame,
};
use trifacet::exit::{self, Failure};
use trifacet::publishing::columns::Columns;
use trifacet_wire::Status;
use trifacet_wire::stream::request::MAX_DIVIDER;

use super::running::RunningArg;
use super::silence::{Heard, SHORTEST, Wait, note};
use super::{within, written};

/// Interval of the text output.
const READABLE: Duration = Duration::from_millis(200);

/// Print the frames of a running daemon
#[derive(Debug, Args)]
pub(crate) struct WatchArgs {
    /// TCP server of the daemon (tcp://HOST:PORT), local address or multicast group to which it sends
    /// datagrams (udp://HOST:PORT), or its server for subscriptions (subscribe://HOST:PORT); by default that of
    /// the configuration, or tcp://127.0.0.1:7361
    endpoint: Option<Endpoint>,
    #[command(flatten)]
    running: RunningArg,
    /// Request every Nth frame (not for udp://)
    #[arg(long, default_value_t = 1, value_parser = within(1..=MAX_DIVIDER))]
    divider: u32,
    /// Request the last valid pose, marked POSE_HELD, if there is no valid one (not for udp://)
    #[arg(long)]
    held: bool,
    /// Receive a multicast group through this interface
    #[arg(long)]
    interface: Option<String>,
    /// Connect again whenever the stream ends
    #[arg(long)]
    reconnect: bool,
    /// Format of the frames
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// End after this number of printed frames
    #[arg(long, value_parser = within(1..=u64::MAX))]
    count: Option<u64>,
}

impl WatchArgs {
    fn options(&self) -> Options {
        Options {
            pace: Pace::Divider(self.divider),
            held: self.held,
            interface: self.interface.clone(),
            reconnect: self.reconnect.then(Backoff::default),
            ..Options::default()
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    /// One line in um and urad, at most five times a second
    Text,
    /// One JSON object per frame, SI units; null for unknown values
    Json,
    /// One CSV line per frame, SI units; empty for unknown values
    Csv,
}

/// Prints frames until `--count` is reached, the output is closed or the daemon ends
/// ([`exit::UNAVAILABLE`]).
pub(crate) fn watch(args: &WatchArgs) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(follow(args))
}

async fn follow(args: &WatchArgs) -> Result<()> {
    let endpoint = args.running.endpoint(args.endpoint.as_ref())?;
    let mut client = match timeout(SHORTEST, Client::connect_with(&endpoint, args.options())).await {
        Ok(client) => client.map_err(|e| opening_failed(&endpoint, &e))?,
        Err(_) => return Err(unavailable(format!("{endpoint} does not answer"))),
    };
    let mut printer = Printer::new(args);
    let mut losses = LossNotes::default();
    let mut wait = Wait::new(None);
    let mut silent = false;
    loop {
        match wait.next(&mut client, &endpoint).await {
            Ok(Heard::Message(Message::Pose(frame))) => {
                silent = false;
                losses.note_own(client.losses());
                if printer.frame(&frame)?.is_break() {
                    return Ok(());
                }
            }
            Ok(Heard::Message(Message::Heartbeat(heartbeat))) => losses.note_daemon(&heartbeat),
            Ok(Heard::Message(_)) => {}
            Ok(Heard::Silence { waited, due }) => {
                let why = silence(&endpoint, client.losses(), waited);
                let waits = args.reconnect || matches!(endpoint, Endpoint::Udp(_));
                if due && (args.count.is_some() || !waits) {
                    return Err(unavailable(why));
                }
                if !silent {
                    note(&format!("{why}; still waiting"));
                }
                silent = true;
            }
            Err(e) => return Err(unavailable(format!("{endpoint}: {e}"))),
        }
    }
}

pub(super) fn unavailable(message: String) -> anyhow::Error {
    Failure::new(exit::UNAVAILABLE, message).into()
}

pub(super) fn opening_failed(endpoint: &Endpoint, error: &ClientError) -> anyhow::Error {
    let kind = match error {
        ClientError::Open { source, .. } => source.kind(),
        _ => io::ErrorKind::Other,
    };
    match (endpoint, kind) {
        (Endpoint::Tcp(_), io::ErrorKind::ConnectionRefused) => {
            unavailable(format!("nothing listens at {endpoint}: is the daemon running (`trifacet run`)?"))
        }
        (Endpoint::Subscribe(_), io::ErrorKind::ConnectionRefused) => unavailable(format!(
            "no server for subscriptions at {endpoint}: is the daemon running, with [publishing] subscribe?"
        )),
        (Endpoint::Udp(_), io::ErrorKind::AddrInUse) => {
            Failure::new(exit::IN_USE, format!("{error}: another process already uses this address")).into()
        }
        _ => unavailable(error.to_string()),
    }
}

/// Possible reasons why no frame arrives.
pub(super) fn silence(endpoint: &Endpoint, losses: Losses, waited: Duration) -> String {
    let waited = waited.as_secs();
    match (endpoint, losses.skipped_bytes) {
        (_, n @ 1..) => {
            format!("{endpoint}: no frame for {waited} s, but {n} bytes that do not belong to this stream")
        }
        (Endpoint::Tcp(_), _) => {
            format!(
                "{endpoint}: connected, but no frame for {waited} s; `trifacet doctor {endpoint}` finds the cause"
            )
        }
        (Endpoint::Subscribe(_), _) => {
            format!(
                "{endpoint}: subscribed, but no frame for {waited} s; `trifacet doctor {endpoint}` finds the cause"
            )
        }
        (Endpoint::Udp(_), _) => format!(
            "{endpoint}: no frame for {waited} s; check that a daemon runs, that this address is among its [publishing] udp \
             targets, and that no firewall is in between; `trifacet doctor {endpoint}` finds the cause"
        ),
    }
}

/// Prints frames to standard output.
struct Printer {
    format: Format,
    left: Option<u64>,
    started: bool,
    shown: Option<Instant>,
    /// Status bits of the frames that were not printed.
    between: Status,
}

impl Printer {
    fn new(args: &WatchArgs) -> Self {
        Self {
            format: args.format,
            left: args.count,
            started: false,
            shown: None,
            between: Status::default(),
        }
    }

    /// Prints a frame if it is due. Breaks after the last one.
    fn frame(&mut self, frame: &PoseFrame) -> Result<ControlFlow<()>> {
        let Some(text) = self.lines(frame) else { return Ok(ControlFlow::Continue(())) };
        written(io::stdout().lock().write_all(text.as_bytes()))?;
        self.started = true;
        if let Some(left) = &mut self.left {
            *left -= 1;
        }
        Ok(if self.left == Some(0) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    }

    fn lines(&mut self, frame: &PoseFrame) -> Option<String> {
        match self.format {
            Format::Text => self.text(frame),
            Format::Json => serde_json::to_string(&Columns::of(frame)).ok().map(|json| json + "\n"),
            Format::Csv => {
                let columns = Columns::of(frame);
                let header = if self.started { String::new() } else { columns.csv_header() + "\n" };
                Some(header + &columns.csv_line() + "\n")
            }
        }
    }

    fn text(&mut self, frame: &PoseFrame) -> Option<String> {
        let now = Instant::now();
        if self.shown.is_some_and(|shown| now - shown < READABLE) {
            self.between |= frame.status;
            return None;
        }
        self.shown = Some(now);
        let between = std::mem::take(&mut self.between);
        let header = if self.started { String::new() } else { text_header() };
        Some(format!("{header}{}\n", text_line(frame, between)))
    }
}

/// The header of the text output. It states that most frames are not shown.
fn text_header() -> String {
    let names = ["tx um", "ty um", "tz um", "roll urad", "pitch urad", "yaw urad"];
    let names: Vec<String> = names.iter().map(|n| format!("{n:>10}")).collect();
    format!(
        "# at most five frames a second are shown; --format json or csv prints all\n{:>10} {} {:>9}  status\n",
        "sequence",
        names.join(" "),
        "lock"
    )
}

fn text_line(frame: &PoseFrame, between: Status) -> String {
    let number = |x: f64| if x.is_nan() { format!("{:>10}", "-") } else { format!("{:>10.3}", x * 1e6) };
    let numbers: Vec<String> = frame.pose.iter().map(|x| number(*x)).collect();
    let names: Vec<&str> = frame.status.names().collect();
    let earlier: Vec<&str> = Status(between.0 & !frame.status.0).names().collect();
    let earlier =
        if earlier.is_empty() { String::new() } else { format!("  (just before: {})", earlier.join(" ")) };
    format!(
        "{:>10} {} {:>9}  {}{earlier}",
        frame.sequence,
        numbers.join(" "),
        frame.lock.name(),
        names.join(" ")
    )
}

/// Reports losses on standard error when they have increased, at most once a second.
#[derive(Default)]
struct LossNotes {
    own: Losses,
    dropped: u64,
    said: Option<Instant>,
}

impl LossNotes {
    fn note_own(&mut self, losses: Losses) {
        let recently = self.said.is_some_and(|t| t.elapsed() < Duration::from_secs(1));
        if losses == self.own || recently {
            return;
        }
        self.said = Some(Instant::now());
        self.own = losses;
        let Losses { missed_frames, late_frames, skipped_bytes } = losses;
        note(&format!(
            "so far {missed_frames} frames missing, {late_frames} late, {skipped_bytes} bytes unreadable"
        ));
    }

    fn note_daemon(&mut self, heartbeat: &Heartbeat) {
        if heartbeat.dropped > self.dropped {
            self.dropped = heartbeat.dropped;
            let dropped = self.dropped;
            note(&format!("the daemon dropped {dropped} frames so far because this client did not keep up"));
        }
    }
}
