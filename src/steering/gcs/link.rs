//! The line to a controller: one query at a time, each with a time-out.

use std::future::poll_fn;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_serial::SerialStream;

use super::fault::Fault;
use super::protocol::Answer;
use super::settings::{Line, Settings};
use crate::serial_port;

/// A serial line counts as quiet after this time without data.
const QUIET: Duration = Duration::from_millis(50);
/// Number of attempts to find the line quiet, before it counts as used by another program.
const LISTENS: usize = 20;

/// A serial or a TCP connection.
trait Wire: AsyncRead + AsyncWrite + Unpin + Send {}
impl<T: AsyncRead + AsyncWrite + Unpin + Send> Wire for T {}

/// An open line.
pub struct Link {
    wire: Box<dyn Wire>,
    name: String,
    patience_ms: u16,
}

impl Link {
    /// Opens the line. Data left from an earlier session on a serial line is discarded.
    ///
    /// # Errors
    /// The line cannot be opened, or is not quiet.
    pub async fn open(settings: &Settings) -> Result<Self, Fault> {
        let name = settings.line.to_string();
        let no_way = |reason: String| Fault::Connect { line: name.clone(), reason };
        let wire: Box<dyn Wire> = match &settings.line {
            Line::Tcp(address) => {
                let patience = Duration::from_millis(settings.timeout_ms.into());
                let connected = timeout(patience, TcpStream::connect(address)).await;
                let stream = connected
                    .map_err(|_| no_way(format!("no answer within {} ms", settings.timeout_ms)))?
                    .map_err(|error| no_way(error.to_string()))?;
                stream.set_nodelay(true).map_err(|error| no_way(error.to_string()))?;
                Box::new(stream)
            }
            Line::Serial { port, baud } => {
                let (path, baud) = (port.clone(), *baud);
                let open = move || serial_port::open(&path, baud, &serial_port::Identity::default());
                let opening = tokio::task::spawn_blocking(open).await;
                let opened = opening.map_err(|error| no_way(error.to_string()))?;
                let opened = opened.map_err(|error| no_way(error.reason()))?;
                Box::new(SerialStream::try_from(opened.tty).map_err(|error| no_way(error.to_string()))?)
            }
        };
        let mut link = Self { wire, name, patience_ms: settings.timeout_ms };
        if matches!(settings.line, Line::Serial { .. }) {
            link.settle().await?;
        }
        Ok(link)
    }

    /// Waits until no more data arrives.
    async fn settle(&mut self) -> Result<(), Fault> {
        let mut buffer = [0; 256];
        let mut received = 0;
        for _ in 0..LISTENS {
            match timeout(QUIET, read(&mut self.wire, &mut buffer)).await {
                Err(_) => return Ok(()),
                Ok(Ok(bytes)) => received = bytes,
                Ok(Err(error)) => return Err(self.gone("the start", &error)),
            }
        }
        Err(Fault::Unasked(buffer[..received].iter().copied().map(char::from).collect()))
    }

    /// Sends lines, of which the last one is a query, and waits for its answer.
    ///
    /// # Errors
    /// The connection is lost, the controller does not answer in time, or data arrives unexpectedly.
    pub async fn ask(&mut self, lines: &str) -> Result<Answer, Fault> {
        self.nothing_waits(lines).await?;
        let mut answer = Answer::default();
        let patience = Duration::from_millis(self.patience_ms.into());
        match timeout(patience, self.exchange(lines, &mut answer)).await {
            Ok(Ok(())) => Ok(answer),
            Ok(Err(fault)) => Err(fault),
            Err(_) => {
                let so_far = Some(answer.so_far()).filter(|text| !text.is_empty());
                Err(Fault::Silent { asked: label(lines), ms: self.patience_ms, so_far })
            }
        }
    }

    async fn exchange(&mut self, lines: &str, answer: &mut Answer) -> Result<(), Fault> {
        self.wire.write_all(lines.as_bytes()).await.map_err(|error| self.gone(lines, &error))?;
        let mut buffer = [0; 256];
        loop {
            let bytes = match read(&mut self.wire, &mut buffer).await {
                Ok(bytes) => &buffer[..bytes],
                Err(error) => return Err(self.gone(lines, &error)),
            };
            let wrong = |error| Fault::Answer { asked: label(lines), error };
            if answer.push(bytes).map_err(wrong)? {
                return Ok(());
            }
        }
    }

    /// Checks that no data is waiting before a query: it would be taken for the answer.
    async fn nothing_waits(&mut self, lines: &str) -> Result<(), Fault> {
        let mut buffer = [0; 80];
        let waits = poll_fn(|cx| match poll_read(&mut self.wire, &mut buffer, cx) {
            Poll::Ready(read) => Poll::Ready(Some(read)),
            Poll::Pending => Poll::Ready(None),
        });
        match waits.await {
            None => Ok(()),
            Some(Ok(bytes)) => Err(Fault::Unasked(buffer[..bytes].iter().copied().map(char::from).collect())),
            Some(Err(error)) => Err(self.gone(lines, &error)),
        }
    }

    fn gone(&self, lines: &str, reason: &io::Error) -> Fault {
        Fault::Gone { line: self.name.clone(), asked: label(lines), reason: reason.to_string() }
    }
}

/// Lines as shown in messages.
pub fn label(lines: &str) -> String {
    lines.trim_end().replace('\n', ", ")
}

async fn read(wire: &mut Box<dyn Wire>, buffer: &mut [u8]) -> io::Result<usize> {
    poll_fn(|cx| poll_read(wire, buffer, cx)).await
}

/// Reads at least one byte; an empty read means that the other side has closed the connection.
fn poll_read(wire: &mut Box<dyn Wire>, buffer: &mut [u8], cx: &mut Context) -> Poll<io::Result<usize>> {
    let mut buffer = ReadBuf::new(buffer);
    Pin::new(wire).poll_read(cx, &mut buffer).map(|read| match (read, buffer.filled().len()) {
        (Ok(()), 0) => Err(io::Error::other("the other side has closed the connection")),
        (Ok(()), bytes) => Ok(bytes),
        (Err(error), _) => Err(error),
    })
}
