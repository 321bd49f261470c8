//! A T7 as a source: the layer between a [`Session`] and its two connections.

use std::future::poll_fn;
use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Clock, Mono};
use trifacet_wire::actuator::OutputCommand;

use super::{Session, Settings};
use crate::acquisition::{Source, SourceError, SourceEvent};
use crate::config::Config;

/// Time limit for opening both connections.
const OPEN: Duration = Duration::from_secs(3);
/// Longest wait at shutdown until the device has answered.
const LAST_ANSWER: Duration = Duration::from_millis(500);

/// The two connections.
#[derive(Debug)]
struct Link {
    registers: TcpStream,
    stream: TcpStream,
}

#[derive(Debug)]
enum Connection {
    /// Being opened, after a pause.
    Opening(JoinHandle<Result<Link, SourceError>>),
    Open(Link),
    Closed,
}

/// Which of the connections has delivered bytes.
#[derive(Clone, Copy, Debug)]
enum From {
    Registers,
    Stream,
}

/// A T7. Opens the connections, and opens them again after a fault.
#[derive(Debug)]
pub struct LabjackSource<C> {
    host: String,
    ports: [u16; 2],
    clock: C,
    session: Session,
    connection: Connection,
    /// A first attempt to connect needs no pause.
    first: bool,
    buffer: Box<[u8; 8192]>,
}

impl<C: Clock> LabjackSource<C> {
    /// The configured device. [`Source::next`] connects; this needs no runtime.
    pub fn new(config: &Config, clock: C, counters: Arc<Counters>) -> Self {
        let labjack = &config.acquisition.labjack;
        Self {
            host: labjack.address.clone(),
            ports: [labjack.port, labjack.stream_port],
            clock,
            session: Session::new(Settings::from(config), counters),
            connection: Connection::Closed,
            first: true,
            buffer: Box::new([0; 8192]),
        }
    }

    /// Waits for the next event of the connections, and passes it to the session. All state is in `self`, so that
    /// this future may be dropped at any time.
    async fn step(&mut self) {
        match &mut self.connection {
            Connection::Closed => {
                let pause =
                    if std::mem::take(&mut self.first) { Duration::ZERO } else { self.session.next_retry() };
                self.connection =
                    Connection::Opening(tokio::spawn(open(self.host.clone(), self.ports, pause)));
            }
            Connection::Opening(opening) => {
                let opened = opening.await.unwrap_or_else(|error| Err(self.unplugged(&error.to_string())));
                self.opened(opened);
            }
            Connection::Open(_) => self.converse().await,
        }
    }

    fn opened(&mut self, opened: Result<Link, SourceError>) {
        let host =
            |link: &Link| link.registers.local_addr().map_or(IpAddr::from([0; 4]), |address| address.ip());
        match opened {
            Ok(link) => {
                self.session.connected(host(&link), self.clock.now());
                self.connection = Connection::Open(link);
            }
            Err(error) => {
                self.session.disconnected(error);
                self.connection = Connection::Closed;
            }
        }
    }

    /// Reads, writes and waits until one of them has a result.
    async fn converse(&mut self) {
        let Connection::Open(link) = &mut self.connection else { return };
        let (session, buffer, now) = (&mut self.session, &mut self.buffer[..], self.clock.now());
        let deadline = session.deadline().map_or(i64::MAX, |deadline| deadline - now);
        let mut sleep = std::pin::pin!(sleep(Duration::from_nanos(deadline.clamp(0, i64::MAX) as u64)));
        let outcome = poll_fn(|cx| {
            // Reading comes first: data that has arrived takes precedence over a time-out.
            if let Poll::Ready(read) = poll_read(link, buffer, cx) {
                return Poll::Ready(read.map(Some));
            }
            if let Poll::Ready(Err(error)) = poll_write(&mut link.registers, session, now, cx) {
                return Poll::Ready(Err(error));
            }
            sleep.as_mut().poll(cx).map(|()| Ok(None))
        })
        .await;
        let now = self.clock.now();
        match outcome {
            Ok(Some((_, 0))) => self.close_link("the device closed the connection"),
            Ok(Some((From::Registers, read))) => self.session.answered(&self.buffer[..read], now),
            Ok(Some((From::Stream, read))) => self.session.streamed(&self.buffer[..read], now),
            Ok(None) => {}
            Err(error) => self.close_link(&error.to_string()),
        }
        self.session.timed_out(now); // while data arrives without end, too
        if self.session.is_broken() {
            self.connection = Connection::Closed;
        }
    }

    fn unplugged(&self, reason: &str) -> SourceError {
        SourceError::Unplugged { port: format!("the LabJack T7 at {}", self.host), reason: reason.into() }
    }

    fn close_link(&mut self, reason: &str) {
        self.connection = Connection::Closed;
        self.session.disconnected(self.unplugged(reason));
    }
}

impl<C: Clock> Source for LabjackSource<C> {
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
        if !matches!(self.connection, Connection::Open(_)) {
            return;
        }
        self.session.stop(self.clock.now());
        let answered = timeout(LAST_ANSWER, async {
            while !self.session.has_stopped() {
                self.converse().await;
            }
        });
        if answered.await.is_err() || self.session.is_broken() {
            tracing::warn!("{}: the T7 has not confirmed the end of its stream", self.host);
        }
    }
}

/// Opens both connections.
async fn open(host: String, ports: [u16; 2], pause: Duration) -> Result<Link, SourceError> {
    sleep(pause).await;
    let connect = async {
        let registers = connected(&host, ports[0]).await?;
        Ok(Link { registers, stream: connected(&host, ports[1]).await? })
    };
    let failed =
        |reason| SourceError::Open { port: format!("the LabJack T7 at {host}:{}", ports[0]), reason };
    match timeout(OPEN, connect).await {
        Ok(opened) => opened.map_err(failed),
        Err(_) => Err(failed(format!("no answer within {} s", OPEN.as_secs()))),
    }
}

async fn connected(host: &str, port: u16) -> Result<TcpStream, String> {
    let connect = async {
        let stream = TcpStream::connect((host, port)).await?;
        stream.set_nodelay(true)?;
        Ok(stream)
    };
    connect.await.map_err(|error: io::Error| format!("port {port}: {error}"))
}

/// Reads from the connection that has bytes; the answers come first, because they are few.
fn poll_read(link: &mut Link, buffer: &mut [u8], cx: &mut Context) -> Poll<io::Result<(From, usize)>> {
    for (stream, from) in [(&mut link.registers, From::Registers), (&mut link.stream, From::Stream)] {
        let mut buffer = ReadBuf::new(buffer);
        if let Poll::Ready(read) = Pin::new(stream).poll_read(cx, &mut buffer) {
            return Poll::Ready(read.map(|()| (from, buffer.filled().len())));
        }
    }
    Poll::Pending
}

/// Writes until the output is empty.
fn poll_write(
    stream: &mut TcpStream,
    session: &mut Session,
    now: Mono,
    cx: &mut Context,
) -> Poll<io::Result<()>> {
    loop {
        let output = session.output(now);
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
