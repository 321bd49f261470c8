//! `trifacet emulate`: an acquisition board on a pseudo-terminal or on a network, backed by the digital twin.

mod command;
mod labjack;
mod link;
mod outlet;

use std::io::{self, BufRead, Write};
use std::path::PathBuf;
use std::time::Duration;

use command::EmulatorCommand;
use labjack::{Device, T7Args};
use outlet::{Outlet, Port};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;
use tokio::task::yield_now;
use tokio::time::{Instant, sleep_until};
use trifacet::clock::SystemClock;
use trifacet::clock::pace::Pace;
use trifacet::config::Network;
use trifacet::core::time::Clock;
use trifacet::exit::{CONFIG, Failure, USAGE};
use trifacet::twin::{Emulator, ListenAt};

use super::{ConfigArg, written};

/// Most samples taken at once: far fewer than the buffer of the board holds.
const PORTION: u64 = 16;

/// Emulate an acquisition board on a pseudo-terminal or on a network, backed by the digital twin.
#[derive(Debug, clap::Args)]
#[command(after_help = format!("{}\n{}", command::HELP, labjack::HELP))]
pub(crate) struct EmulateArgs {
    /// Create PATH as a symbolic link to the port, and remove it at the end
    #[arg(long, value_name = "PATH")]
    link: Option<PathBuf>,
    /// Listen for a host at this address or Unix socket, instead of a pseudo-terminal; port 0 stands for any free port
    #[arg(long, value_name = "ADDRESS|unix:PATH", conflicts_with = "link")]
    listen: Option<ListenAt>,
    /// Accept hosts from this network or address; by default only those of this machine. Required to listen at another
    /// address than a loopback one
    #[arg(long, value_name = "NETWORK", requires = "listen")]
    allow: Vec<Network>,
    /// Version of the board protocol
    #[arg(long, value_name = "VERSION", value_parser = ["1.0", "1.1"], default_value = "1.1")]
    protocol: String,
    /// Kind of device
    #[arg(long, value_name = "DEVICE", value_enum, default_value = "board")]
    device: Device,
    #[command(flatten)]
    t7: T7Args,
    #[command(flatten)]
    config: ConfigArg,
}

impl EmulateArgs {
    /// Minor version of the protocol.
    fn minor(&self) -> u8 {
        u8::from(self.protocol != "1.0")
    }
}

/// Runs the board until SIGTERM, SIGINT or a failure.
pub(crate) fn emulate(args: &EmulateArgs) -> anyhow::Result<()> {
    let outlet = Outlet::new(args.listen.clone(), args.link.clone(), &args.allow)?;
    let config = args.config.load()?;
    if args.device == Device::T7 {
        if args.link.is_some() {
            return Err(
                Failure::new(USAGE, "--link is for a board: --device t7 has no pseudo-terminal").into()
            );
        }
        return labjack::emulate(&args.t7, &config);
    }
    if args.t7.has_port() {
        return Err(Failure::new(USAGE, "--port and --stream-port require --device t7").into());
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let pace = Pace::new(SystemClock, config.acquisition.rate_hz)?;
        let board = Emulator::new(&config, pace.schedule().time(0))
            .map_err(|error| Failure::new(CONFIG, error.to_string()))?
            .with_minor(args.minor());
        let bench = Bench { board, pace, port: None, outlet, plug_in: Some(Instant::now()) };
        bench.run().await
    })
}

/// The board, its cable, and the schedule of its samples.
struct Bench {
    board: Emulator,
    pace: Pace<SystemClock>,
    port: Option<Port>,
    outlet: Outlet,
    /// Time at which the cable is plugged in again. `None` while it is plugged in.
    plug_in: Option<Instant>,
}

impl Bench {
    async fn run(mut self) -> anyhow::Result<()> {
        let mut ends = [signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?];
        let mut orders = lines_of_stdin();
        self.plug_in()?;
        let (mut sampled, mut due) = (0, 0);
        loop {
            tokio::select! {
                more = self.pace.due() => due += more?,
                // After a pause of the machine, many samples are due. They are taken in portions, so that
                // the line can carry some of them before the buffer of the board is full.
                () = yield_now(), if due > 0 => {
                    for _ in 0..due.min(PORTION) {
                        self.board.sample(self.pace.schedule().time(sampled));
                        sampled += 1;
                        due -= 1;
                    }
                }
                carried = carry(&mut self.port, &mut self.board) => carried?,
                Some(line) = orders.recv() => self.obey(&line)?,
                () = until(self.plug_in) => self.plug_in()?,
                () = any(&mut ends) => return Ok(()),
            }
        }
    }

    /// Opens the port, and prints where it is.
    fn plug_in(&mut self) -> anyhow::Result<()> {
        let (port, place) = self.outlet.open()?;
        say(&place)?;
        self.port = Some(port);
        self.plug_in = None;
        Ok(())
    }

    fn obey(&mut self, line: &str) -> anyhow::Result<()> {
        match line.parse() {
            Ok(EmulatorCommand::Status) => say(&serde_json::to_string(&self.board.state())?)?,
            Ok(EmulatorCommand::Pose(to)) => self.board.travel(&to),
            Ok(EmulatorCommand::Restart) => {
                self.board.restart(SystemClock.now());
            }
            Ok(EmulatorCommand::Unplug { for_s }) => {
                self.port = None;
                self.board.unheard();
                self.plug_in = Some(Instant::now() + Duration::from_secs_f64(for_s));
            }
            Ok(EmulatorCommand::Fault { kind, for_s }) => {
                if let Err(error) = self.board.inject(kind, for_s) {
                    refuse(&error.to_string());
                }
            }
            Err(error) => refuse(&error.to_string()),
        }
        Ok(())
    }
}

/// Carries bytes while the cable is plugged in.
async fn carry(port: &mut Option<Port>, board: &mut Emulator) -> anyhow::Result<()> {
    let refused = match port {
        Some(port) => port.exchange(board, &SystemClock).await?,
        None => std::future::pending().await,
    };
    if let Some(refused) = refused {
        refuse(&refused.to_string());
    }
    Ok(())
}

async fn until(moment: Option<Instant>) {
    match moment {
        Some(moment) => sleep_until(moment).await,
        None => std::future::pending().await,
    }
}

async fn any([a, b]: &mut [Signal; 2]) {
    tokio::select! { _ = a.recv() => {}, _ = b.recv() => {} }
}

/// Lines of standard input. A separate thread reads them, and the program does not wait for it at the end,
/// because a read may block for ever.
fn lines_of_stdin() -> mpsc::Receiver<String> {
    let (sender, receiver) = mpsc::channel(16);
    std::thread::spawn(move || {
        for line in io::stdin().lock().lines().map_while(Result::ok) {
            if sender.blocking_send(line).is_err() {
                break;
            }
        }
    });
    receiver
}

fn say(line: &str) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    written(writeln!(out, "{line}").and_then(|()| out.flush()))
}

fn refuse(reason: &str) {
    let _ = writeln!(io::stderr(), "trifacet: {reason}"); // standard error may be closed
}
