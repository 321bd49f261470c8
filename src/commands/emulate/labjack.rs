//! `trifacet emulate --device t7`: a LabJack T7 at two TCP ports.

use std::fmt;
use std::future::poll_fn;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use anyhow::Context as _;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::signal::unix::{SignalKind, signal};
use tokio::task::yield_now;
use tokio::time::Instant;
use trifacet::acquisition::labjack::modbus::Frames;
use trifacet::acquisition::labjack::stream::StreamStatus;
use trifacet::clock::SystemClock;
use trifacet::clock::pace::Pace;
use trifacet::config::Config;
use trifacet::core::time::Clock;
use trifacet::exit::{CONFIG, Failure};
use trifacet::twin::labjack::{T7, T7Fault};

use super::command::EmulatorCommand;
use super::{PORTION, any, lines_of_stdin, refuse, say, until};

/// The commands of a T7 in addition to those of a board, as `--help` lists them.
pub(super) const HELP: &str = "\
With --device t7, the addresses of registers and stream are printed instead, and these commands are added:
  recovery N                the buffer of the stream counts as full until N scans are skipped
  jump N                    N packets of the stream are not sent
  overlap, overflow, complete
                            the stream ends with the status 2942, 2943 or 2944
  second-session S          another program ends the stream, and streams itself for S seconds";

/// Kind of emulated device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Device {
    /// A board on a pseudo-terminal
    Board,
    /// A LabJack T7 at two TCP ports
    T7,
}

/// Options of a T7.
#[derive(Debug, clap::Args)]
pub(super) struct T7Args {
    /// Address at which the T7 listens; anyone who reaches it can move its outputs
    #[arg(long, value_name = "IP", default_value = "127.0.0.1")]
    address: IpAddr,
    /// Port of the registers of the T7; 0: any free one [default: acquisition.labjack.port]
    #[arg(long, value_name = "PORT")]
    port: Option<u16>,
    /// Port of the stream of the T7; 0: any free one [default: acquisition.labjack.stream_port]
    #[arg(long, value_name = "PORT")]
    stream_port: Option<u16>,
}

impl T7Args {
    /// Whether a port is stated.
    pub(super) fn has_port(&self) -> bool {
        self.port.or(self.stream_port).is_some()
    }
}

/// Runs the device until SIGTERM, SIGINT or a failure.
pub(super) fn emulate(args: &T7Args, config: &Config) -> anyhow::Result<()> {
    let labjack = &config.acquisition.labjack;
    let ports = [args.port.unwrap_or(labjack.port), args.stream_port.unwrap_or(labjack.stream_port)];
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let pace = Pace::new(SystemClock, config.acquisition.rate_hz)?;
        let device = T7::new(config, pace.schedule().time(0))
            .map_err(|error| Failure::new(CONFIG, error.to_string()))?;
        let addresses = ports.map(|port| SocketAddr::new(args.address, port));
        Bench { device, pace, addresses, plug: None, plug_in: None }.run().await
    })
}

/// The device, its cable, and the schedule of its scans.
struct Bench {
    device: T7,
    pace: Pace<SystemClock>,
    /// Of the registers and of the stream.
    addresses: [SocketAddr; 2],
    plug: Option<Plug>,
    /// Time at which the cable is plugged in again. `None` while it is plugged in.
    plug_in: Option<Instant>,
}

impl Bench {
    async fn run(mut self) -> anyhow::Result<()> {
        let mut ends = [signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?];
        let mut orders = lines_of_stdin();
        self.plug_in().await?;
        let (mut sampled, mut due) = (0, 0);
        loop {
            tokio::select! {
                more = self.pace.due() => due += more?,
                () = yield_now(), if due > 0 => {
                    for _ in 0..due.min(PORTION) {
                        self.device.sample(self.pace.schedule().time(sampled));
                        sampled += 1;
                        due -= 1;
                    }
                }
                () = carry(&mut self.plug, &mut self.device) => {}
                Some(line) = orders.recv() => self.obey(&line)?,
                () = until(self.plug_in) => self.plug_in().await?,
                () = any(&mut ends) => return Ok(()),
            }
        }
    }

    /// Listens at both ports, and prints them.
    async fn plug_in(&mut self) -> anyhow::Result<()> {
        let [registers, stream] = self.addresses;
        let bind = async |at: SocketAddr| {
            TcpListener::bind(at).await.with_context(|| format!("cannot listen at {at}"))
        };
        let listeners = [bind(registers).await?, bind(stream).await?];
        self.addresses = [listeners[0].local_addr()?, listeners[1].local_addr()?];
        say(&format!("registers {} stream {}", self.addresses[0], self.addresses[1]))?;
        self.plug = Some(Plug { listeners, hosts: Vec::new(), streams: Vec::new() });
        self.plug_in = None;
        Ok(())
    }

    fn obey(&mut self, line: &str) -> anyhow::Result<()> {
        if let Some(fault) = fault(line) {
            self.device.fail(fault, SystemClock.now());
            return Ok(());
        }
        match line.parse() {
            Ok(EmulatorCommand::Status) => say(&serde_json::to_string(&self.device.state())?)?,
            Ok(EmulatorCommand::Pose(to)) => self.device.travel(&to),
            Ok(EmulatorCommand::Restart) => {
                self.device.restart(SystemClock.now());
                if let Some(plug) = &mut self.plug {
                    (plug.hosts, plug.streams) = (Vec::new(), Vec::new());
                }
            }
            Ok(EmulatorCommand::Unplug { for_s }) => {
                self.plug = None;
                self.device.unheard();
                self.plug_in = Some(Instant::now() + Duration::from_secs_f64(for_s));
            }
            Ok(EmulatorCommand::Fault { kind, for_s }) => {
                if let Err(error) = self.device.inject(kind, for_s) {
                    refuse(&error.to_string());
                }
            }
            Err(error) => refuse(&format!(
                "{error}; of a T7 also recovery N, jump N, overlap, overflow, complete, second-session S"
            )),
        }
        Ok(())
    }
}

/// A fault that only a T7 has.
fn fault(line: &str) -> Option<T7Fault> {
    let words: Vec<_> = line.split_whitespace().collect();
    Some(match words[..] {
        ["recovery", scans] => T7Fault::Recovery(scans.parse().ok()?),
        ["jump", packets] => T7Fault::Jump(packets.parse().ok()?),
        ["overlap"] => T7Fault::End(StreamStatus::Overlap),
        ["overflow"] => T7Fault::End(StreamStatus::Overflow),
        ["complete"] => T7Fault::End(StreamStatus::Complete),
        ["second-session", seconds] => {
            T7Fault::SecondSession(seconds.parse().ok().filter(|s| (0.0..=1e6).contains(s))?)
        }
        _ => return None,
    })
}

/// A connection of a host to the registers.
struct Host {
    socket: TcpStream,
    frames: Frames,
    out: Vec<u8>,
}

/// The ports and their connections.
struct Plug {
    /// Of the registers and of the stream.
    listeners: [TcpListener; 2],
    hosts: Vec<Host>,
    /// The first of them gets the stream.
    streams: Vec<TcpStream>,
}

impl fmt::Debug for Plug {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} hosts, {} streams", self.hosts.len(), self.streams.len())
    }
}

/// Carries bytes while the cable is plugged in.
async fn carry(plug: &mut Option<Plug>, device: &mut T7) {
    poll_fn(|cx| match plug {
        Some(plug) => plug.poll(device, cx),
        None => Poll::Pending,
    })
    .await;
}

impl Plug {
    /// Accepts, reads and writes what is possible; ready if anything was.
    fn poll(&mut self, device: &mut T7, cx: &mut Context) -> Poll<()> {
        let mut progress = false;
        if let Poll::Ready(Ok((socket, _))) = self.listeners[0].poll_accept(cx) {
            let _ = socket.set_nodelay(true); // only the delay would suffer
            self.hosts.push(Host { socket, frames: Frames::default(), out: Vec::new() });
            progress = true;
        }
        if let Poll::Ready(Ok((socket, _))) = self.listeners[1].poll_accept(cx) {
            let _ = socket.set_nodelay(true);
            self.streams.push(socket);
            progress = true;
        }
        self.hosts.retain_mut(|host| match host.poll(device, cx) {
            Poll::Ready(Ok(())) => {
                progress = true;
                true
            }
            Poll::Ready(Err(_)) => false, // that host has gone
            Poll::Pending => true,
        });
        self.streams.retain_mut(|socket| !is_closed(socket, cx));
        if let Some(socket) = self.streams.first_mut() {
            progress |= match poll_stream(socket, device, cx) {
                Poll::Ready(Ok(())) => true,
                Poll::Ready(Err(_)) => {
                    device.unheard();
                    self.streams.remove(0);
                    true
                }
                Poll::Pending => false,
            };
        } else {
            device.unheard();
        }
        if progress { Poll::Ready(()) } else { Poll::Pending }
    }
}

impl Host {
    fn poll(&mut self, device: &mut T7, cx: &mut Context) -> Poll<io::Result<()>> {
        let mut bytes = [0; 1024];
        let mut buffer = ReadBuf::new(&mut bytes);
        let mut progress = false;
        if let Poll::Ready(read) = Pin::new(&mut self.socket).poll_read(cx, &mut buffer) {
            read?;
            if buffer.filled().is_empty() {
                return Poll::Ready(Err(io::ErrorKind::UnexpectedEof.into()));
            }
            self.frames.push(buffer.filled());
            while let Some(request) = self.frames.next_frame().map_err(io::Error::other)? {
                device.answer(&request, SystemClock.now()).encode(&mut self.out);
            }
            progress = true;
        }
        while !self.out.is_empty() {
            match Pin::new(&mut self.socket).poll_write(cx, &self.out) {
                Poll::Ready(written) => {
                    self.out.drain(..written?);
                    progress = true;
                }
                Poll::Pending => break,
            }
        }
        if progress { Poll::Ready(Ok(())) } else { Poll::Pending }
    }
}

/// Whether the other side has closed the connection; what it sends is of no interest.
fn is_closed(socket: &mut TcpStream, cx: &mut Context) -> bool {
    let mut bytes = [0; 64];
    let mut buffer = ReadBuf::new(&mut bytes);
    match Pin::new(socket).poll_read(cx, &mut buffer) {
        Poll::Ready(read) => read.is_err() || buffer.filled().is_empty(),
        Poll::Pending => false,
    }
}

fn poll_stream(socket: &mut TcpStream, device: &mut T7, cx: &mut Context) -> Poll<io::Result<()>> {
    let mut progress = false;
    loop {
        let output = device.output();
        if output.is_empty() {
            break;
        }
        match Pin::new(&mut *socket).poll_write(cx, output) {
            Poll::Ready(Ok(written)) => device.written(written),
            Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
            Poll::Pending => break,
        }
        progress = true;
    }
    if progress { Poll::Ready(Ok(())) } else { Poll::Pending }
}
