//! The TCP server, on the slow side. Each client gets the descriptor, then frames and heartbeats.
//!
//! All clients read from one ring of frames at their own pace. One that falls behind by more than the
//! ring loses the oldest frames, which is counted for it, and no other client notices.

use std::{io, net::SocketAddr, sync::Arc, time::Duration};

use tokio::{
    io::AsyncWriteExt,
    net::{TcpListener, TcpStream},
    sync::{
        broadcast::{
            self,
            error::{RecvError, TryRecvError},
        },
        mpsc,
    },
    task::JoinSet,
    time::{MissedTickBehavior, interval, sleep, timeout},
};
use tokio_util::sync::CancellationToken;

use super::{
    descriptor::{Descriptor, Heartbeat, Refusal},
    frame::FrameBytes,
    message::{Kind, json},
};
use crate::{
    exit::{self, Failure},
    monitor::Counters,
};

/// A client that takes nothing for this long is dropped: half-open, or hung.
const STALL: Duration = Duration::from_secs(10);
/// Bytes that the kernel may hold for a client. The default grows to megabytes: seconds of old frames.
const SEND_BUFFER: usize = 256 * 1024;
/// Most frames in one write.
const BATCH: usize = 64;
const HEARTBEAT: Duration = Duration::from_secs(1);
/// At shutdown: how long the last frames may take to come in, and then to go out.
const DRAIN: Duration = Duration::from_millis(500);

/// Bounds of the server.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Most clients at a time; further ones are refused.
    pub clients: usize,
    /// Frames that a client may be behind, at least; rounded up to a power of two.
    pub queue: usize,
}

/// Opens the port and logs the address. Fails with [`exit::IN_USE`] if someone else has it.
pub async fn bind(address: SocketAddr) -> Result<TcpListener, Failure> {
    let listener = TcpListener::bind(address).await.map_err(|e| {
        let (code, why) = match e.kind() {
            io::ErrorKind::AddrInUse => (exit::IN_USE, "another process has the port".to_owned()),
            _ => (exit::IO, e.to_string()),
        };
        Failure::new(code, format!("cannot listen on {address} for TCP clients: {why}"))
    })?;
    let address = listener.local_addr().unwrap_or(address);
    tracing::info!(%address, "listening");
    Ok(listener)
}

/// Serves the frames that come in until `shutdown`, or until no more can come; then sends what is
/// still there, within a second at most.
///
/// Fails only if the descriptor cannot be put into a message.
pub async fn serve(
    listener: TcpListener,
    mut frames: mpsc::Receiver<FrameBytes>,
    descriptor: &Descriptor,
    limits: Limits,
    counters: Arc<Counters>,
    shutdown: CancellationToken,
) -> Result<(), Failure> {
    let greeting = json(Kind::Descriptor, descriptor)
        .map_err(|e| Failure::new(exit::SOFTWARE, format!("the descriptor cannot be sent: {e}")))?;
    let (ring, _) = broadcast::channel(limits.queue.clamp(1, 1 << 20));
    let mut server = Server { greeting: greeting.into(), limits, counters, clients: JoinSet::new() };
    tokio::select! {
        () = forward(&mut frames, &ring) => {}
        () = server.accept_all(&listener, &ring) => {}
        () = shutdown.cancelled() => {}
    }
    drop(listener);
    let _ = timeout(DRAIN, forward(&mut frames, &ring)).await;
    drop(ring);
    server.finish().await;
    Ok(())
}

/// Puts frames on the ring until none can come any more.
async fn forward(frames: &mut mpsc::Receiver<FrameBytes>, ring: &broadcast::Sender<FrameBytes>) {
    while let Some(frame) = frames.recv().await {
        // Fails if there is no client, which is no loss.
        let _ = ring.send(frame);
    }
}

struct Server {
    greeting: Arc<[u8]>,
    limits: Limits,
    counters: Arc<Counters>,
    clients: JoinSet<()>,
}

impl Server {
    async fn accept_all(&mut self, listener: &TcpListener, ring: &broadcast::Sender<FrameBytes>) {
        loop {
            match listener.accept().await {
                Ok((stream, address)) => self.admit(stream, address, ring.subscribe()),
                Err(e) => {
                    // Out of file descriptors, as a rule: nothing to do but wait for some.
                    tracing::warn!("cannot accept a TCP client: {e}");
                    sleep(Duration::from_millis(100)).await;
                }
            }
        }
    }

    fn admit(&mut self, stream: TcpStream, address: SocketAddr, frames: broadcast::Receiver<FrameBytes>) {
        while self.clients.try_join_next().is_some() {}
        if self.clients.len() >= self.limits.clients {
            tracing::warn!(client = %address, limit = self.limits.clients, "refused: too many TCP clients");
            refuse(stream, self.limits.clients);
            return;
        }
        let client = Client {
            stream,
            frames,
            greeting: self.greeting.clone(),
            counters: self.counters.clone(),
            sent: 0,
            dropped: 0,
        };
        self.clients.spawn(async move {
            tracing::info!(client = %address, "connected");
            client.run(address).await;
        });
    }

    /// Lets the clients take what is still on the ring.
    async fn finish(&mut self) {
        let all_done = async { while self.clients.join_next().await.is_some() {} };
        if timeout(DRAIN, all_done).await.is_err() {
            tracing::warn!(
                clients = self.clients.len(),
                "cut off: TCP clients that did not take the last frames in time"
            );
        }
    }
}

/// Says why, if the socket takes it at once (a new one does), and closes.
fn refuse(stream: TcpStream, limit: usize) {
    let error = format!("the daemon serves {limit} TCP clients already, the most it is configured for");
    let Ok(message) = json(Kind::Refusal, &Refusal { error }) else { return };
    if let Ok(stream) = stream.into_std() {
        let _ = io::Write::write(&mut &stream, &message);
        let _ = stream.shutdown(std::net::Shutdown::Write);
    }
}

struct Client {
    stream: TcpStream,
    frames: broadcast::Receiver<FrameBytes>,
    greeting: Arc<[u8]>,
    counters: Arc<Counters>,
    sent: u64,
    dropped: u64,
}

impl Client {
    async fn run(mut self, address: SocketAddr) {
        let end = match self.stream_frames().await {
            Ok(()) => "the daemon ends".to_owned(),
            Err(e) => match e.kind() {
                io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset => {
                    "closed by the client".to_owned()
                }
                io::ErrorKind::TimedOut => {
                    self.lost(self.frames.len() as u64); // it was cut off from these
                    format!("took nothing for {} s", STALL.as_secs())
                }
                _ => e.to_string(),
            },
        };
        let Self { sent, dropped, .. } = self;
        tracing::info!(client = %address, sent, dropped, "disconnected: {end}");
    }

    /// Sends frames and heartbeats until the ring closes.
    async fn stream_frames(&mut self) -> io::Result<()> {
        self.stream.set_nodelay(true)?;
        rustix::net::sockopt::set_tcp_user_timeout(&self.stream, STALL.as_millis() as u32)?;
        rustix::net::sockopt::set_socket_send_buffer_size(&self.stream, SEND_BUFFER)?;
        let greeting = self.greeting.clone();
        self.write(&greeting).await?;
        let mut heartbeat = interval(HEARTBEAT);
        heartbeat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut open = true;
        let mut ignored = [0; 1024];
        loop {
            // Whichever of these is dropped unfinished has taken nothing yet.
            tokio::select! {
                biased;
                _ = heartbeat.tick() => self.beat().await?,
                frame = self.frames.recv() => match frame {
                    Ok(frame) => self.send_batch(frame).await?,
                    Err(RecvError::Lagged(n)) => self.lost(n),
                    Err(RecvError::Closed) => break,
                },
                // Clients have nothing to say in this version. One that only stops talking may listen on.
                n = read(&self.stream, &mut ignored), if open => open = n? > 0,
            }
        }
        self.beat().await?;
        self.stream.shutdown().await
    }

    /// Sends a frame with those that are already waiting behind it.
    async fn send_batch(&mut self, first: FrameBytes) -> io::Result<()> {
        let mut batch = first.to_vec();
        let mut count = 1;
        while count < BATCH {
            match self.frames.try_recv() {
                Ok(frame) => batch.extend(frame),
                Err(TryRecvError::Lagged(n)) => {
                    self.lost(n);
                    continue;
                }
                Err(TryRecvError::Empty | TryRecvError::Closed) => break,
            }
            count += 1;
        }
        self.write(&batch).await?;
        self.sent += count as u64;
        Ok(())
    }

    async fn beat(&mut self) -> io::Result<()> {
        let message = json(Kind::Heartbeat, &Heartbeat::new(self.sent, self.dropped, &self.counters))?;
        self.write(&message).await
    }

    fn lost(&mut self, n: u64) {
        self.dropped += n;
        self.counters.tcp_dropped.add(n);
    }

    /// Writes all of it, as long as the client takes some of it every now and then.
    async fn write(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            let n = timeout(STALL, self.stream.write(bytes)).await??;
            bytes = &bytes[n..];
        }
        Ok(())
    }
}

/// Reads what is there; waits until there is something. Zero: the client says no more.
async fn read(stream: &TcpStream, buffer: &mut [u8]) -> io::Result<usize> {
    loop {
        stream.readable().await?;
        match stream.try_read(buffer) {
            Err(e) if e.kind() == io::ErrorKind::WouldBlock => {}
            result => return result,
        }
    }
}
