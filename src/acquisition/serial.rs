//! A board on a serial port: the layer between a [`Session`] and the port.

use std::future::poll_fn;
use std::io;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use serialport::TTYPort;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};
use tokio_serial::SerialStream;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Clock, Mono};
use trifacet_wire::actuator::OutputCommand;

use super::board::{Session, Settings};
use super::{Source, SourceError, SourceEvent};
use crate::config::Config;
use crate::exit::{Failure, IN_USE};
use crate::serial_port::{self, Identity, Opened, PortError};

/// Pause between two attempts to open the port.
const RETRY: Duration = Duration::from_millis(200);
/// Longest wait at shutdown until the last frames are written.
const LAST_WRITE: Duration = Duration::from_millis(100);

/// The state of the port.
#[derive(Debug)]
enum Port {
    /// Opened, but not yet registered with the runtime.
    Opened(TTYPort),
    /// Being opened, after a pause.
    Opening(JoinHandle<Result<Opened, PortError>>),
    /// In use.
    Open(SerialStream),
    /// Closed; to be opened.
    Closed,
}

/// A board on a serial port. Opens the port, and opens it again after a disconnection.
#[derive(Debug)]
pub struct SerialSource<C> {
    path: PathBuf,
    baud: u32,
    clock: C,
    session: Session,
    port: Port,
    /// The device that was at the port last.
    device: Identity,
    buffer: Box<[u8; 4096]>,
}

impl<C: Clock> SerialSource<C> {
    /// Opens the configured port. Blocks while the system opens it; needs no runtime. If the port does not
    /// exist yet, [`Source::next`] waits for it.
    ///
    /// # Errors
    /// [`IN_USE`] if another process uses the port; the message names the process.
    pub fn open(config: &Config, clock: C, counters: Arc<Counters>) -> Result<Self, Failure> {
        let serial = &config.acquisition.serial;
        let mut session = Session::new(Settings::from(config), counters);
        let mut device = Identity::default();
        let port = match serial_port::open(&serial.port, serial.baud, &device) {
            Ok(opened) => {
                device = opened.identity;
                Port::Opened(opened.tty)
            }
            Err(error @ PortError::InUse { .. }) => return Err(Failure::new(IN_USE, error.to_string())),
            Err(error) => {
                session.disconnected(error.into());
                Port::Closed
            }
        };
        Ok(Self {
            path: serial.port.clone(),
            baud: serial.baud,
            clock,
            session,
            port,
            device,
            buffer: Box::new([0; 4096]),
        })
    }

    /// Waits for the next event on the port, and passes it to the session. All state is in `self`, so that
    /// this future may be dropped at any time.
    async fn step(&mut self) {
        match &mut self.port {
            Port::Closed => {
                let (path, baud, last) = (self.path.clone(), self.baud, self.device.clone());
                self.port = Port::Opening(tokio::task::spawn_blocking(move || {
                    std::thread::sleep(RETRY);
                    serial_port::open(&path, baud, &last)
                }));
            }
            Port::Opening(opening) => {
                let opened = match opening.await {
                    Ok(opened) => opened,
                    Err(error) => {
                        Err(PortError::Other { port: self.path.clone(), reason: error.to_string() })
                    }
                };
                self.port = match opened {
                    Ok(opened) => {
                        self.device = opened.identity;
                        Port::Opened(opened.tty)
                    }
                    Err(error) => {
                        self.session.disconnected(error.into());
                        Port::Closed
                    }
                };
            }
            Port::Opened(_) => self.connect(),
            Port::Open(_) => self.converse().await,
        }
    }

    /// Registers the open port with the runtime.
    fn connect(&mut self) {
        let Port::Opened(port) = std::mem::replace(&mut self.port, Port::Closed) else { return };
        match SerialStream::try_from(port) {
            Ok(stream) => {
                self.port = Port::Open(stream);
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
            Ok(Some(0)) => self.unplugged("the other side closed the connection".into()),
            Ok(Some(read)) => self.session.received(&self.buffer[..read], now),
            Ok(None) => self.session.timed_out(now),
            Err(error) => self.unplugged(error.to_string()),
        }
    }

    fn unplugged(&mut self, reason: String) {
        self.port = Port::Closed;
        self.session.disconnected(SourceError::Unplugged { port: self.path.display().to_string(), reason });
    }
}

impl<C: Clock> Source for SerialSource<C> {
    async fn next(&mut self) -> SourceEvent {
        loop {
            if let Some(event) = self.session.event() {
                return event;
            }
            self.step().await;
        }
    }

    fn steer(&mut self, command: OutputCommand, now: Mono) {
        self.session.steer(command, now);
    }

    async fn close(mut self) {
        let Port::Open(mut stream) = std::mem::replace(&mut self.port, Port::Closed) else { return };
        let session = &mut self.session;
        session.stop();
        let written = timeout(LAST_WRITE, poll_fn(|cx| poll_write(&mut stream, session, cx))).await;
        if !matches!(written, Ok(Ok(()))) {
            tracing::warn!("{}: the stop request could not be sent to the board", self.path.display());
        }
    }
}

fn poll_read(stream: &mut SerialStream, buffer: &mut [u8], cx: &mut Context) -> Poll<io::Result<usize>> {
    let mut buffer = ReadBuf::new(buffer);
    Pin::new(stream).poll_read(cx, &mut buffer).map_ok(|()| buffer.filled().len())
}

/// Writes until the output is empty.
fn poll_write(stream: &mut SerialStream, session: &mut Session, cx: &mut Context) -> Poll<io::Result<()>> {
    loop {
        let output = session.output();
        if output.is_empty() {
            return Poll::Ready(Ok(()));
        }
        match Pin::new(&mut *stream).poll_write(cx, output) {
            Poll::Ready(Ok(0)) => return Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
            Poll::Ready(Ok(written)) => session.written(written),
            Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
            Poll::Pending => return Poll::Pending,
        }
    }
}
