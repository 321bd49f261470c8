//! `trifacet status`: prints the state of a running daemon.

mod screen;

pub(super) use screen::drift;

use std::io::{self, IsTerminal, Write as _};
use std::path::Path;
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use rustix::termios::tcgetwinsize;
use serde_json::Value;
use tokio::time::{Instant, MissedTickBehavior, interval_at, timeout};
use trifacet::client::{Backoff, Client, Descriptor, Endpoint, Heartbeat, Message, Options, PoseFrame};
use trifacet::control::{self, Command};
use trifacet_wire::Status;

use super::running::{RunningArg, SocketArg};
use super::silence::{Heard, SHORTEST, Wait, note};
use super::watch::{opening_failed, silence, unavailable};
use super::written;

/// Longest time to wait for the control socket.
const ASIDE: Duration = Duration::from_secs(1);

/// Print the state of a running daemon
#[derive(Debug, Args)]
pub(crate) struct StatusArgs {
    /// Source of the stream, as for `watch`
    endpoint: Option<Endpoint>,
    #[command(flatten)]
    running: RunningArg,
    /// Continue: redraw on a terminal, otherwise write a line each time
    #[arg(long)]
    follow: bool,
    /// Interval of the updates, in seconds
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = seconds, requires = "follow")]
    interval: f64,
    #[command(flatten)]
    socket: SocketArg,
}

/// An interval that is not a number of seconds in the allowed range.
#[derive(Debug, thiserror::Error)]
#[error("allowed is 0.1 to 3600")]
struct IntervalError;

fn seconds(text: &str) -> Result<f64, IntervalError> {
    text.parse().ok().filter(|s| (0.1..=3600.0).contains(s)).ok_or(IntervalError)
}

/// Data received from the daemon.
#[derive(Default)]
struct Known {
    descriptor: Option<Descriptor>,
    heartbeat: Option<Heartbeat>,
    frame: Option<PoseFrame>,
    /// Status bits of the frames since the last update.
    between: Status,
    /// Number of frames since the last update.
    frames: u64,
    /// Number of frames that are missing in the stream.
    missing: u64,
    /// Answer of the control socket, if it belongs to the same daemon.
    control: Option<Value>,
    /// Why there is no answer although the socket exists.
    unanswered: Option<String>,
}

/// Prints the state once, or until the output is closed. Fails with [`trifacet::exit::UNAVAILABLE`] if no
/// daemon answers.
pub(crate) fn status(args: &StatusArgs) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let result = runtime.block_on(look(args));
    runtime.shutdown_background(); // do not wait for a control socket that does not answer
    result
}

async fn look(args: &StatusArgs) -> Result<()> {
    let options = Options { reconnect: args.follow.then(Backoff::default), ..Options::default() };
    let endpoint = &args.running.endpoint(args.endpoint.as_ref())?;
    // A daemon without a control socket gives less data.
    let socket = args.running.socket(&args.socket).unwrap_or_default();
    let mut client = match timeout(SHORTEST, Client::connect_with(endpoint, options)).await {
        Ok(client) => client.map_err(|e| opening_failed(endpoint, &e))?,
        Err(_) => return Err(unavailable(format!("{endpoint} does not answer"))),
    };
    let mut known = Known::default();
    known.first(&mut client, endpoint).await?;
    known.ask(&socket).await;
    let mut screen = Screen::new(args, endpoint);
    screen.show(&known)?;
    if !args.follow {
        return Ok(());
    }
    let period = Duration::from_secs_f64(args.interval);
    let mut looks = interval_at(Instant::now() + period, period);
    looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        known.forget();
        loop {
            tokio::select! {
                biased;
                _ = looks.tick() => break,
                message = client.next() => known.hear(message.map_err(|e| unavailable(format!("{endpoint}: {e}")))?),
            }
        }
        known.missing = client.losses().missed_frames;
        known.ask(&socket).await;
        screen.show(&known)?;
    }
}

impl Known {
    /// Waits for a frame and, if the stream has them, for the counters.
    async fn first(&mut self, client: &mut Client, endpoint: &Endpoint) -> Result<()> {
        let mut wait = Wait::new(None);
        let whole =
            |known: &Self| known.frame.is_some() && (known.heartbeat.is_some() || known.descriptor.is_none());
        while !whole(self) {
            match wait.next(client, endpoint).await {
                Ok(Heard::Message(message)) => self.hear(message),
                Ok(Heard::Silence { .. }) if self.frame.is_some() => return Ok(()),
                Ok(Heard::Silence { waited, due }) => {
                    let why = silence(endpoint, client.losses(), waited);
                    if due {
                        return Err(unavailable(why));
                    }
                    note(&format!("{why}; still waiting"));
                }
                Err(error) => return Err(unavailable(format!("{endpoint}: {error}"))),
            }
        }
        Ok(())
    }

    fn hear(&mut self, message: Message) {
        match message {
            Message::Pose(frame) => {
                self.between |= frame.status;
                self.frames += 1;
                self.frame = Some(frame);
            }
            Message::Descriptor(descriptor) => self.descriptor = Some(*descriptor),
            Message::Heartbeat(heartbeat) => self.heartbeat = Some(heartbeat),
            Message::Event(_) | Message::Answer(_) | Message::Refusal(_) => {}
        }
    }

    /// Resets the data of an update.
    fn forget(&mut self) {
        (self.frame, self.between, self.frames) = (None, Status::default(), 0);
    }

    async fn ask(&mut self, socket: &Path) {
        let path = socket.to_owned();
        let asked = tokio::task::spawn_blocking(move || control::client::ask(&path, &Command::Status));
        let answer = match timeout(ASIDE, asked).await {
            Ok(Ok(answer)) => answer.map_err(|e| e.message),
            Ok(Err(e)) => Err(e.to_string()),
            Err(_) => Err(format!("{} does not answer", socket.display())),
        };
        // Without a socket, the daemon is on another machine or has none: this is not reported.
        self.unanswered = answer.as_ref().err().filter(|_| socket.exists()).cloned();
        let answer = answer.ok();
        let session = self.frame.map(|frame| format!("{:08x}", frame.session));
        self.control = answer.filter(|answer| answer["session"].as_str() == session.as_deref());
    }
}

/// Form of the output.
#[derive(Clone, Copy, PartialEq)]
enum Layout {
    /// One page.
    Page,
    /// A page that replaces the previous one.
    Redrawn,
    /// One line per update.
    Lines,
}

/// State of the output.
struct Screen {
    /// Endpoint of the stream.
    source: String,
    form: Layout,
    colour: bool,
    /// Number of lines of the last page, or of all lines.
    drawn: usize,
}

impl Screen {
    fn new(args: &StatusArgs, endpoint: &Endpoint) -> Self {
        let terminal = io::stdout().is_terminal();
        let wanted = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
        let form = match (args.follow, terminal) {
            (false, _) => Layout::Page,
            (true, true) => Layout::Redrawn,
            (true, false) => Layout::Lines,
        };
        Self { source: endpoint.to_string(), form, colour: terminal && wanted, drawn: 0 }
    }

    fn show(&mut self, known: &Known) -> Result<()> {
        let text = match self.form {
            Layout::Lines => {
                let header = if self.drawn == 0 { screen::header() + "\n" } else { String::new() };
                self.drawn += 1;
                header + &screen::line(known) + "\n"
            }
            Layout::Page | Layout::Redrawn => self.page(known),
        };
        let mut out = io::stdout().lock();
        written(out.write_all(text.as_bytes()).and_then(|()| out.flush()))
    }

    /// The page. A redrawn page replaces the previous one.
    fn page(&mut self, known: &Known) -> String {
        let lines = screen::page(&self.source, known);
        if self.form == Layout::Page {
            return lines.iter().map(|line| self.painted(line, line.len()) + "\n").collect();
        }
        let width = tcgetwinsize(io::stdout()).map_or(0, |size| usize::from(size.ws_col));
        let width = if width < 20 { 80 } else { width }; // a terminal of unknown width reports 0
        let up = if self.drawn > 0 { format!("\x1b[{}A", self.drawn) } else { String::new() };
        self.drawn = lines.len();
        // Lines are cut to the width of the terminal, because wrapped lines would shift the next page.
        let page: String = lines.iter().map(|line| self.painted(line, width - 1) + "\x1b[K\n").collect();
        format!("{up}{page}\x1b[J")
    }

    /// A line of at most `width` characters, in the colour of its meaning.
    fn painted(&self, line: &str, width: usize) -> String {
        let cut: String = line.chars().take(width).collect();
        match screen::mood(line) {
            Some(colour) if self.colour => format!("\x1b[{colour}m{cut}\x1b[0m"),
            _ => cut,
        }
    }
}
