//! One TCP connection: reads command lines; writes answers, frames and heartbeats.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::sync::broadcast::{self};
use tokio::sync::watch;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval, sleep_until, timeout};
use trifacet_core::centering::lock::LockCondition;
use trifacet_wire::stream::lines::Lines;
use trifacet_wire::stream::request::MAX_LINE;
use trifacet_wire::stream::{ClientCommand, StreamRequest};

use super::context::{ServerContext, part};
use crate::publishing::descriptor::heartbeat;
use crate::publishing::encoding::{ClientEncoder, EncodedFrame, answer, farewell};
use crate::publishing::lock_event::lock_event;
use crate::publishing::query;

/// Send buffer of the kernel in bytes. The default grows to megabytes, which is seconds of old frames.
const SEND_BUFFER: usize = 256 * 1024;
/// Most frames in one write.
const BATCH: usize = 64;
const HEARTBEAT: Duration = Duration::from_secs(1);
/// Lines without a valid command after which the connection is closed: the peer speaks another protocol.
const BAD_LINES: u32 = 100;

pub(super) struct Client {
    stream: TcpStream,
    ring: broadcast::Receiver<Arc<EncodedFrame>>,
    context: Arc<ServerContext>,
    form: Option<ClientEncoder>,
    lock: watch::Receiver<Option<LockCondition>>,
    /// Number of the last change of the lock state that was sent.
    told: Option<u64>,
    heartbeat: Interval,
    lines: Lines,
    bad_lines: u32,
    /// Time of the last complete line.
    last_line: Instant,
    /// The client may still send.
    open: bool,
    sent: u64,
    dropped: u64,
    /// Frames that the ring lost for this client and that are not yet counted in `dropped`.
    lagged: u64,
}

/// Why a connection ends.
enum End {
    /// The daemon stops.
    Daemon,
    /// The client closed the connection or sent `bye`.
    Client,
    /// The daemon closes the connection for this reason.
    Refused(String),
}

/// The next event of a connection.
enum Event {
    Beat,
    Bytes(io::Result<usize>),
    Frame(Result<Arc<EncodedFrame>, RecvError>),
    Lock,
    Idle,
    Ending,
}

impl Client {
    pub(super) fn new(
        stream: TcpStream,
        ring: broadcast::Receiver<Arc<EncodedFrame>>,
        context: Arc<ServerContext>,
    ) -> Self {
        Self {
            stream,
            ring,
            lock: context.sources.lock.clone(),
            context,
            form: None,
            told: None,
            heartbeat: beats(),
            lines: Lines::default(),
            bad_lines: 0,
            last_line: Instant::now(),
            open: true,
            sent: 0,
            dropped: 0,
            lagged: 0,
        }
    }

    pub(super) async fn run(mut self, address: SocketAddr) {
        let stall = self.context.limits.stall;
        let result = self.talk().await;
        self.settle();
        let end = match &result {
            Ok(End::Daemon) => "the daemon stops".to_owned(),
            Ok(End::Client) => "closed by the client".to_owned(),
            Ok(End::Refused(why)) => format!("closed by the daemon: {why}"),
            Err(e) => match e.kind() {
                io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset => {
                    "closed by the client".to_owned()
                }
                io::ErrorKind::TimedOut => format!("accepted no data for {} s", stall.as_secs_f64()),
                _ => e.to_string(),
            },
        };
        let Self { sent, dropped, .. } = self;
        tracing::info!(client = %address, sent, dropped, "disconnected: {end}");
        let last_word = match result {
            Ok(End::Refused(why)) => farewell(self.form.as_ref(), &why).unwrap_or_default(),
            Ok(_) => Vec::new(),
            Err(_) => return,
        };
        part(self.stream, last_word).await;
    }

    async fn talk(&mut self) -> io::Result<End> {
        self.stream.set_nodelay(true)?;
        let stall = u32::try_from(self.context.limits.stall.as_millis()).unwrap_or(u32::MAX);
        rustix::net::sockopt::set_tcp_user_timeout(&self.stream, stall)?;
        rustix::net::sockopt::set_socket_send_buffer_size(&self.stream, SEND_BUFFER)?;
        let mut buffer = [0; 1024];
        loop {
            let end = match self.event(&mut buffer).await {
                Event::Beat => {
                    self.beat().await?;
                    None
                }
                Event::Lock => {
                    self.tell_lock().await?;
                    None
                }
                Event::Bytes(n) => self.said(&buffer[..n?]).await?,
                Event::Frame(Ok(encoded)) => {
                    self.send_batch(&encoded).await?;
                    None
                }
                Event::Frame(Err(RecvError::Lagged(n))) => {
                    self.lagged += n;
                    None
                }
                Event::Frame(Err(RecvError::Closed)) => {
                    self.beat().await?;
                    Some(End::Daemon)
                }
                Event::Ending => Some(End::Daemon),
                Event::Idle => {
                    let patience = self.context.limits.idle.as_secs_f64();
                    Some(End::Refused(format!("no complete line for {patience} s; {}", allowed())))
                }
            };
            if let Some(end) = end {
                return Ok(end);
            }
        }
    }

    /// Waits for the first event. All branches are cancel-safe: an unfinished one has consumed nothing.
    async fn event(&mut self, buffer: &mut [u8]) -> Event {
        let streaming = self.form.is_some();
        let events = self.form.as_ref().is_some_and(ClientEncoder::events);
        tokio::select! {
            biased;
            _ = self.heartbeat.tick(), if streaming => Event::Beat,
            Ok(()) = self.lock.changed(), if events => Event::Lock,
            n = read(&self.stream, buffer), if self.open => Event::Bytes(n),
            encoded = self.ring.recv(), if streaming => Event::Frame(encoded),
            () = sleep_until(self.last_line + self.context.limits.idle), if !streaming => Event::Idle,
            () = self.context.ending.cancelled(), if !streaming => Event::Ending,
        }
    }

    /// Handles received bytes. No bytes mean that the client has closed its sending side; a stream goes on.
    async fn said(&mut self, bytes: &[u8]) -> io::Result<Option<End>> {
        self.lines.push(bytes);
        while let Some(line) = self.lines.next_line() {
            let Ok(line) = line else {
                return Ok(Some(End::Refused(format!("a line of more than {MAX_LINE} bytes"))));
            };
            self.last_line = Instant::now();
            if let Some(end) = self.obey(&line).await? {
                return Ok(Some(end));
            }
        }
        self.open = !bytes.is_empty();
        Ok((!self.open && self.form.is_none()).then_some(End::Client))
    }

    /// Executes a command line.
    async fn obey(&mut self, line: &[u8]) -> io::Result<Option<End>> {
        if line.trim_ascii().is_empty() {
            return Ok(None);
        }
        let text = match ClientCommand::parse(line) {
            Ok(ClientCommand::Stream(request)) => {
                self.start(request).await?;
                return Ok(None);
            }
            Ok(ClientCommand::Bye) => return Ok(Some(End::Client)),
            Ok(ClientCommand::Help) => ClientCommand::help().to_owned(),
            Ok(ClientCommand::Descriptor) => {
                let bytes = match &self.form {
                    Some(form) => form.descriptor(&self.context.sources.descriptor.borrow())?,
                    None => query::descriptor(&self.context.sources.descriptor.borrow())?,
                };
                self.write(&bytes).await?;
                return Ok(None);
            }
            Ok(ClientCommand::Pose) => self.ask(query::pose),
            Ok(ClientCommand::Status) => self.ask(query::status),
            Err(error) => {
                self.bad_lines += 1;
                if self.bad_lines >= BAD_LINES {
                    return Ok(Some(End::Refused(format!(
                        "{BAD_LINES} lines without a valid command; {}",
                        allowed()
                    ))));
                }
                error.to_string()
            }
        };
        let bytes = answer(self.form.as_ref(), &text)?;
        self.write(&bytes).await?;
        Ok(None)
    }

    fn ask(&self, say: impl Fn(&EncodedFrame, f64, Option<LockCondition>) -> String) -> String {
        let newest = self.context.newest.borrow().clone();
        match newest {
            Some(encoded) => {
                let rate_hz = self.context.sources.descriptor.borrow().rate_hz;
                let lock = (*self.lock.borrow()).and_then(|now| now.explaining(encoded.frame().lock));
                say(&encoded, rate_hz, lock)
            }
            None => "error: no frame has been made yet; allowed: the same query later".into(),
        }
    }

    /// Starts a stream, or changes the running one.
    async fn start(&mut self, request: StreamRequest) -> io::Result<()> {
        let descriptor = self.context.sources.descriptor.borrow().clone();
        let form = ClientEncoder::new(request, descriptor.rate_hz);
        let greeting = form.greeting(&descriptor)?;
        if self.form.is_none() {
            self.ring = self.ring.resubscribe();
        }
        self.heartbeat = beats();
        (self.form, self.told) = (Some(form), None);
        self.write(&greeting).await?;
        self.tell_lock().await
    }

    /// Sends the lock state to a client that requests events, unless it has been sent.
    async fn tell_lock(&mut self) -> io::Result<()> {
        let Some(form) = self.form.as_ref().filter(|form| form.events()) else { return Ok(()) };
        let now = *self.lock.borrow_and_update();
        let Some(now) = now.filter(|now| self.told != Some(now.number)) else { return Ok(()) };
        self.told = Some(now.number);
        let bytes = form.event(&lock_event(&now))?;
        self.write(&bytes).await
    }

    /// Sends a frame together with those that are waiting behind it.
    async fn send_batch(&mut self, first: &Arc<EncodedFrame>) -> io::Result<()> {
        let mut batch = Vec::with_capacity(256);
        let mut count = self.append(first, &mut batch)?;
        for _ in 1..BATCH {
            match self.ring.try_recv() {
                Ok(encoded) => count += self.append(&encoded, &mut batch)?,
                Err(TryRecvError::Lagged(n)) => self.lagged += n,
                Err(TryRecvError::Empty | TryRecvError::Closed) => break,
            }
        }
        self.write(&batch).await?;
        self.sent += count;
        Ok(())
    }

    /// Appends a frame if the client wants it, and counts the frames lost before it. Returns frames appended.
    fn append(&mut self, encoded: &Arc<EncodedFrame>, to: &mut Vec<u8>) -> io::Result<u64> {
        let Some(form) = &self.form else { return Ok(0) };
        let lost = form.wanted_before(encoded, std::mem::take(&mut self.lagged));
        self.dropped += lost;
        self.context.counters.tcp_dropped.add(lost);
        if !form.wants(encoded) {
            return Ok(0);
        }
        form.frame(encoded, to)?;
        Ok(1)
    }

    /// At the end, counts the frames that the ring lost for this client since its last frame.
    fn settle(&mut self) {
        loop {
            match self.ring.try_recv() {
                Err(TryRecvError::Lagged(n)) => self.lagged += n,
                Ok(encoded) => {
                    // An error could only come from encoding; its result is not used.
                    let _ = self.append(&encoded, &mut Vec::new());
                    return;
                }
                Err(TryRecvError::Empty | TryRecvError::Closed) => return,
            }
        }
    }

    async fn beat(&mut self) -> io::Result<()> {
        let Some(form) = &self.form else { return Ok(()) };
        let lock = self.context.lock().as_ref().map(lock_event);
        let bytes = form.heartbeat(&heartbeat(self.sent, self.dropped, &self.context.counters, lock))?;
        self.write(&bytes).await
    }

    /// Writes all bytes. Fails if the client accepts none of them for the stall time.
    async fn write(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            let n = timeout(self.context.limits.stall, self.stream.write(bytes)).await??;
            bytes = &bytes[n..];
        }
        Ok(())
    }
}

fn allowed() -> String {
    format!("allowed: {}", ClientCommand::help())
}

/// The interval of heartbeats. The first one is due at once.
fn beats() -> Interval {
    let mut beats = interval(HEARTBEAT);
    beats.set_missed_tick_behavior(MissedTickBehavior::Delay);
    beats
}

/// Reads available bytes; waits until there are some. Zero: the client has closed its sending side.
async fn read(stream: &TcpStream, buffer: &mut [u8]) -> io::Result<usize> {
    loop {
        stream.readable().await?;
        match stream.try_read(buffer) {
            Err(e) if e.kind() == io::ErrorKind::WouldBlock => {}
            result => return result,
        }
    }
}
