//! `trifacet status`: how a running daemon is doing, at a glance.

mod screen;

use std::io::{self, IsTerminal, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use rustix::termios::tcgetwinsize;
use serde_json::Value;
use tokio::time::{Instant, MissedTickBehavior, interval_at, timeout, timeout_at};
use trifacet::client::{Backoff, Client, Descriptor, Endpoint, Heartbeat, Message, Options, PoseFrame};
use trifacet::control::{self, Command};
use trifacet_wire::Status;

use super::watch::{SILENCE, opening_failed, unavailable};
use super::written;

/// An answer of the control socket that takes longer is none.
const ASIDE: Duration = Duration::from_secs(1);

/// How a running daemon is doing, at a glance
#[derive(Debug, Args)]
pub(crate) struct StatusArgs {
    /// Where the stream comes from, as for `watch`
    #[arg(default_value = "tcp://127.0.0.1:7361")]
    endpoint: Endpoint,
    /// Go on: redraw on a terminal, write a line each time anywhere else
    #[arg(long)]
    follow: bool,
    /// Seconds from one look to the next
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = seconds, requires = "follow")]
    interval: f64,
    /// The daemon's control socket, which knows more; without it the stream has to do
    #[arg(long, value_name = "PATH", default_value = "/run/trifacet/control.sock")]
    socket: PathBuf,
}

fn seconds(text: &str) -> Result<f64, String> {
    let allowed = || "allowed is 0.1 to 3600".to_owned();
    text.parse().ok().filter(|s| (0.1..=3600.0).contains(s)).ok_or_else(allowed)
}

/// What is known of the daemon.
#[derive(Default)]
struct Known {
    descriptor: Option<Descriptor>,
    heartbeat: Option<Heartbeat>,
    frame: Option<PoseFrame>,
    /// Status bits of the frames since the last look.
    between: Status,
    /// Frames since the last look.
    frames: u64,
    /// Frames that are missing in the stream.
    missing: u64,
    /// The answer of the control socket, if it is that of the same daemon.
    control: Option<Value>,
    /// Why there is none, though there is a socket.
    unanswered: Option<String>,
}

/// Shows it once, or until the output is closed. Fails with [`trifacet::exit::UNAVAILABLE`] if nothing is there.
pub(crate) fn status(args: &StatusArgs) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let result = runtime.block_on(look(args));
    runtime.shutdown_background(); // a control socket that does not answer is not waited for
    result
}

async fn look(args: &StatusArgs) -> Result<()> {
    let options = Options { reconnect: args.follow.then(Backoff::default), ..Options::default() };
    let endpoint = &args.endpoint;
    let mut client = match timeout(SILENCE, Client::connect_with(endpoint, options)).await {
        Ok(client) => client.map_err(|e| opening_failed(endpoint, &e))?,
        Err(_) => return Err(unavailable(format!("{endpoint} does not answer"))),
    };
    let mut known = Known::default();
    if let Err(why) = known.first(&mut client).await {
        return Err(unavailable(format!("{endpoint}: {why}")));
    }
    known.ask(&args.socket).await;
    let mut screen = Screen::new(args);
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
        known.ask(&args.socket).await;
        screen.show(&known)?;
    }
}

impl Known {
    /// Waits for a frame and, where there are any, for the counters.
    async fn first(&mut self, client: &mut Client) -> Result<(), String> {
        let end = Instant::now() + SILENCE;
        let whole =
            |known: &Self| known.frame.is_some() && (known.heartbeat.is_some() || known.descriptor.is_none());
        while !whole(self) {
            match timeout_at(end, client.next()).await {
                Ok(Ok(message)) => self.hear(message),
                Ok(Err(error)) => return Err(error.to_string()),
                Err(_) if self.frame.is_some() => return Ok(()),
                Err(_) => return Err(format!("no frame for {} s", SILENCE.as_secs())),
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
            Message::Answer(_) | Message::Refusal(_) => {}
        }
    }

    /// Before the next look.
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
        // Without a socket the daemon is elsewhere, or has none: no news.
        self.unanswered = answer.as_ref().err().filter(|_| socket.exists()).cloned();
        let answer = answer.ok();
        let session = self.frame.map(|frame| format!("{:08x}", frame.session));
        self.control = answer.filter(|answer| answer["session"].as_str() == session.as_deref());
    }
}

/// How it is shown.
#[derive(Clone, Copy, PartialEq)]
enum Form {
    /// A page, once.
    Page,
    /// A page over the last one.
    Redrawn,
    /// A line each time.
    Lines,
}

/// Where it is shown.
struct Screen {
    /// Where it comes from.
    source: String,
    form: Form,
    colour: bool,
    /// Lines written so far; those of the last page.
    drawn: usize,
}

impl Screen {
    fn new(args: &StatusArgs) -> Self {
        let terminal = io::stdout().is_terminal();
        let wanted = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
        let form = match (args.follow, terminal) {
            (false, _) => Form::Page,
            (true, true) => Form::Redrawn,
            (true, false) => Form::Lines,
        };
        Self { source: args.endpoint.to_string(), form, colour: terminal && wanted, drawn: 0 }
    }

    fn show(&mut self, known: &Known) -> Result<()> {
        let text = match self.form {
            Form::Lines => {
                let header = if self.drawn == 0 { screen::header() + "\n" } else { String::new() };
                self.drawn += 1;
                header + &screen::line(known) + "\n"
            }
            Form::Page | Form::Redrawn => self.page(known),
        };
        let mut out = io::stdout().lock();
        written(out.write_all(text.as_bytes()).and_then(|()| out.flush()))
    }

    /// The page; over the last one, where it is redrawn.
    fn page(&mut self, known: &Known) -> String {
        let lines = screen::page(&self.source, known);
        if self.form == Form::Page {
            return lines.iter().map(|line| self.painted(line, line.len()) + "\n").collect();
        }
        let width = tcgetwinsize(io::stdout()).map_or(0, |size| usize::from(size.ws_col));
        let width = if width < 20 { 80 } else { width }; // a terminal that does not know says 0
        let up = if self.drawn > 0 { format!("\x1b[{}A", self.drawn) } else { String::new() };
        self.drawn = lines.len();
        // Each line is cut to the terminal, or the next page would not begin where this one did.
        let page: String = lines.iter().map(|line| self.painted(line, width - 1) + "\x1b[K\n").collect();
        format!("{up}{page}\x1b[J")
    }

    /// A line of so many characters at most, in the colour of what it says.
    fn painted(&self, line: &str, width: usize) -> String {
        let cut: String = line.chars().take(width).collect();
        match screen::mood(line) {
            Some(colour) if self.colour => format!("\x1b[{colour}m{cut}\x1b[0m"),
            _ => cut,
        }
    }
}
