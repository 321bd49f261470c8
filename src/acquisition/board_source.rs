//! A board as a source: the layer between a [`Session`] and the link to the board.

use std::future::poll_fn;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Clock, Mono};
use trifacet_wire::actuator::OutputCommand;

use super::board::{Session, Settings};
use super::{Source, SourceError, SourceEvent};
use crate::board_link::{self, Link, LinkError, Wire};
use crate::config::{BoardPlace, Config};
use crate::exit::{CONFIG, Failure, IN_USE};
use crate::serial_port::Identity;

/// Pause between two attempts to open a serial port.
const RETRY: Duration = Duration::from_millis(200);
/// Pause before the first attempt to connect over a network. It doubles with each attempt that leads to no scans ...
const FIRST_PAUSE: Duration = Duration::from_millis(100);
/// ... as often as this.
const DOUBLINGS: u32 = 4;
/// Bytes read at once: a burst of some hundred scans.
const BUFFER: usize = 32_768;
/// Longest wait at shutdown until the last frames are written.
const LAST_WRITE: Duration = Duration::from_millis(100);

/// The state of the link.
#[derive(Debug)]
enum Port {
    /// Opened, but not yet registered with the runtime.
    Opened(Link),
    /// Being opened, after a pause.
    Opening(JoinHandle<(Result<Link, LinkError>, Identity)>),
    /// In use.
    Open(Box<dyn Wire>),
    /// Closed; to be opened.
    Closed,
}

/// A board. Opens the link to it, and opens it again after a disconnection.
#[derive(Debug)]
pub struct BoardSource<C> {
    place: BoardPlace,
    clock: C,
    session: Session,
    port: Port,
    /// The device that was at the serial port last.
    device: Identity,
    /// Attempts to open the link since the last scan.
    attempts: u32,
    buffer: Box<[u8]>,
}

impl<C: Clock> BoardSource<C> {
    /// Opens the configured serial port, which blocks while the system opens it; needs no runtime. If the port does
    /// not exist yet, [`Source::next`] waits for it. Over a network, [`Source::next`] connects.
    ///
    /// # Errors
    /// [`IN_USE`] if another process uses the serial port; the message names the process. [`CONFIG`] if the source of
    /// the configuration is no board.
    pub fn open(config: &Config, clock: C, counters: Arc<Counters>) -> Result<Self, Failure> {
        let none = || Failure::new(CONFIG, "acquisition.source is no board");
        let place = config.acquisition.board().ok_or_else(none)?;
        let mut session = Session::new(Settings::from(config), counters);
        let mut device = Identity::default();
        let port = match &place {
            BoardPlace::Serial { .. } => match board_link::open(&place, &mut device) {
                Ok(link) => Port::Opened(link),
                Err(error) if error.is_in_use() => return Err(Failure::new(IN_USE, error.to_string())),
                Err(error) => {
                    session.disconnected(not_open(&place, &error));
                    Port::Closed
                }
            },
            BoardPlace::Tcp(_) | BoardPlace::Unix(_) => Port::Closed,
        };
        let buffer = vec![0; BUFFER].into();
        Ok(Self { place, clock, session, port, device, attempts: 0, buffer })
    }

    /// The pause before the next attempt to open the link.
    fn pause(&self) -> Duration {
        match self.place {
            BoardPlace::Serial { .. } => RETRY,
            BoardPlace::Tcp(_) | BoardPlace::Unix(_) => FIRST_PAUSE * 2_u32.pow(self.attempts.min(DOUBLINGS)),
        }
    }

    /// Waits for the next event on the port, and passes it to the session. All state is in `self`, so that
    /// this future may be dropped at any time.
    async fn step(&mut self) {
        match &mut self.port {
            Port::Closed => {
                let (place, mut device, pause) = (self.place.clone(), self.device.clone(), self.pause());
                self.attempts = self.attempts.saturating_add(1);
                self.port = Port::Opening(tokio::spawn(async move {
                    sleep(pause).await;
                    let lost = LinkError::Connect { place: place.to_string(), reason: "not opened".into() };
                    let opening = move || (board_link::open(&place, &mut device), device);
                    let opened = tokio::task::spawn_blocking(opening).await;
                    opened.unwrap_or((Err(lost), Identity::default()))
                }));
            }
            Port::Opening(opening) => {
                let Ok((opened, device)) = opening.await else {
                    self.port = Port::Closed;
                    return;
                };
                self.device = device;
                self.port = match opened {
                    Ok(link) => Port::Opened(link),
                    Err(error) => {
                        self.session.disconnected(not_open(&self.place, &error));
                        Port::Closed
                    }
                };
            }
            Port::Opened(_) => self.connect(),
            Port::Open(_) => self.converse().await,
        }
    }

    /// Registers the open link with the runtime.
    fn connect(&mut self) {
        let Port::Opened(link) = std::mem::replace(&mut self.port, Port::Closed) else { return };
        match link.into_wire() {
            Ok(wire) => {
                self.port = Port::Open(wire);
                self.session.connected(self.clock.now());
            }
            Err(error) => self.unplugged(error.to_string()),
        }
    }

    /// Reads, writes and waits until one of them has a result.
    async fn converse(&mut self) {
        let Port::Open(stream) = &mut self.port else { return };
        let (session, buffer) = (&mut self.session, &mut self.buffer[..]);
        let deadline = session.deadline().map_or(i64::MAX, |deadline| deadline - self.clock.now());
        let mut sleep = std::pin::pin!(sleep(Duration::from_nanos(deadline.clamp(0, i64::MAX) as u64)));
        let outcome = poll_fn(|cx| {
            // Reading comes first: data that has arrived takes precedence over a time-out.
            if let Poll::Ready(read) = poll_read(stream, buffer, cx) {
                return Poll::Ready(read.map(Some));
            }
            if let Poll::Ready(Err(error)) = poll_write(stream, session, cx) {
                return Poll::Ready(Err(error));
            }
            sleep.as_mut().poll(cx).map(|()| Ok(None))
        })
        .await;
        let now = self.clock.now();
        match outcome {
            Ok(Some(0)) => self.unplugged(board_link::closed().to_string()),
            Ok(Some(read)) => self.session.received(&self.buffer[..read], now),
            Ok(None) => self.session.timed_out(now),
            Err(error) => self.unplugged(error.to_string()),
        }
    }

    fn unplugged(&mut self, reason: String) {
        self.port = Port::Closed;
        self.session.disconnected(SourceError::Unplugged { port: self.place.to_string(), reason });
    }
}

impl<C: Clock> Source for BoardSource<C> {
    async fn next(&mut self) -> SourceEvent {
        loop {
            if let Some(event) = self.session.event() {
                if matches!(event, SourceEvent::Scan(_)) {
                    self.attempts = 0;
                }
                return event;
            }
            self.step().await;
        }
    }

    fn steer(&mut self, command: OutputCommand, now: Mono) {
        self.session.steer(command, now);
    }

    async fn close(mut self) {
        let Port::Open(mut wire) = std::mem::replace(&mut self.port, Port::Closed) else { return };
        let session = &mut self.session;
        session.stop();
        let written = timeout(LAST_WRITE, poll_fn(|cx| poll_write(&mut wire, session, cx))).await;
        if !matches!(written, Ok(Ok(()))) {
            tracing::warn!("{}: the stop request could not be sent to the board", self.place);
        }
        // A connection that is closed while it still holds scans is reset, and the stop request may be lost.
        if matches!(self.place, BoardPlace::Tcp(_) | BoardPlace::Unix(_)) {
            let _ = timeout(LAST_WRITE, finish(&mut wire, &mut self.buffer)).await; // the board closes it otherwise
        }
    }
}

/// Closes the sending direction, and reads until the other side closes its own.
async fn finish(wire: &mut Box<dyn Wire>, buffer: &mut [u8]) -> io::Result<()> {
    wire.shutdown().await?;
    while wire.read(buffer).await? > 0 {}
    Ok(())
}

fn not_open(place: &BoardPlace, error: &LinkError) -> SourceError {
    SourceError::Open { port: place.to_string(), reason: error.reason() }
}

fn poll_read(wire: &mut Box<dyn Wire>, buffer: &mut [u8], cx: &mut Context) -> Poll<io::Result<usize>> {
    let mut buffer = ReadBuf::new(buffer);
    Pin::new(wire).poll_read(cx, &mut buffer).map_ok(|()| buffer.filled().len())
}

/// Writes until the output is empty.
fn poll_write(wire: &mut Box<dyn Wire>, session: &mut Session, cx: &mut Context) -> Poll<io::Result<()>> {
    loop {
        let output = session.output();
        if output.is_empty() {
            return Poll::Ready(Ok(()));
        }
        match Pin::new(&mut *wire).poll_write(cx, output) {
            Poll::Ready(Ok(0)) => return Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
            Poll::Ready(Ok(written)) => session.written(written),
            Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
            Poll::Pending => return Poll::Pending,
        }
    }
}
