//! The task that accepts subscriptions to datagrams, on the main thread. It owns [`Subscriptions`], the socket
//! for requests, and a socket for each subscriber. The fast side sends frames from the latter.

use std::collections::HashMap;
use std::io;
use std::net::{self, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use rustix::net::{SendFlags, sendto};
use tokio::net::UdpSocket;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::sleep;
use tokio_util::sync::CancellationToken;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::Clock;

use super::subscription::{Outcome, Subscriptions};
use super::udp::socket::open_subscriber;
use super::udp::{Kind, Receiver, Way};
use crate::exit::Failure;
use crate::listening::open_udp;

/// Longest request in bytes. The rest of a longer datagram is cut off.
const LONGEST: usize = 512;
/// Requests that can wait for this task.
const QUEUE: usize = 64;
/// Time between two attempts to receive after an error.
const PAUSE: Duration = Duration::from_millis(100);

/// A request and its sender.
type Request = (SocketAddr, Vec<u8>);

/// The open port, before the first request.
#[derive(Debug)]
pub struct SubscriptionServer {
    socket: net::UdpSocket,
    own: SocketAddr,
    list: watch::Sender<Arc<[Receiver]>>,
}

/// Opens the port and logs its address.
///
/// # Errors
/// The socket cannot be opened; with [`crate::exit::IN_USE`] if another process uses the port.
pub fn open(address: SocketAddr) -> Result<SubscriptionServer, Failure> {
    let open = || {
        let socket = open_udp(address)?;
        let own = socket.local_addr()?;
        io::Result::Ok((socket, own))
    };
    let (socket, own) =
        open().map_err(|e| Failure::port(format_args!("open {address} for UDP subscriptions"), &e))?;
    tracing::info!(address = %own, "accepting UDP subscriptions");
    Ok(SubscriptionServer { socket, own, list: watch::Sender::new([].into()) })
}

impl SubscriptionServer {
    /// The current subscribers.
    pub fn subscribers(&self) -> watch::Receiver<Arc<[Receiver]>> {
        self.list.subscribe()
    }

    /// Serves requests until `stop`.
    ///
    /// # Errors
    /// The runtime does not accept the socket.
    pub async fn run(
        self,
        subscriptions: Subscriptions,
        clock: impl Clock,
        counters: &Counters,
        stop: CancellationToken,
    ) -> io::Result<()> {
        let (sender, mut requests) = mpsc::channel(QUEUE);
        let socket = Arc::new(UdpSocket::from_std(self.socket)?);
        let mut reader = JoinSet::new();
        reader.spawn(read(Arc::clone(&socket), sender.clone()));
        let Self { own, list, .. } = self;
        let mut server = Server { socket, own, list, subscriptions, open: HashMap::new(), requests: sender };
        loop {
            let wait = server.subscriptions.next_end().map(|end| (end - clock.now()).max(0) as u64);
            tokio::select! {
                biased;
                () = stop.cancelled() => return Ok(()),
                () = sleep(Duration::from_nanos(wait.unwrap_or_default())), if wait.is_some() => {
                    if server.subscriptions.expire(clock.now()) {
                        server.publish();
                    }
                }
                // The server itself holds a sender, so that the channel stays open.
                Some((from, bytes)) = requests.recv() => server.serve(from, &bytes, &clock, counters),
            }
        }
    }
}

/// The state of the task.
struct Server {
    socket: Arc<UdpSocket>,
    own: SocketAddr,
    list: watch::Sender<Arc<[Receiver]>>,
    subscriptions: Subscriptions,
    open: HashMap<SocketAddr, Open>,
    requests: mpsc::Sender<Request>,
}

/// A subscriber with its socket.
struct Open {
    socket: Arc<UdpSocket>,
    receiver: Receiver,
    /// The task that reads its further requests; ends with this value.
    _reader: JoinSet<()>,
}

impl Server {
    fn serve(&mut self, from: SocketAddr, bytes: &[u8], clock: &impl Clock, counters: &Counters) {
        let mut outcome = self.subscriptions.datagram(from, bytes, clock.now());
        if outcome.changed
            && let Err(e) = self.open(from)
        {
            tracing::warn!(client = %from, "cannot open a socket for a UDP subscription: {e}");
            outcome = self.subscriptions.revoke(from, &format!("cannot open a socket for you: {e}"));
        }
        let Outcome { answer, changed, refused } = outcome;
        if refused {
            counters.udp_refused.inc();
        }
        if let Some(answer) = answer {
            let socket = self.open.get(&from).map_or(&self.socket, |open| &open.socket);
            // The client repeats its request if the answer is lost.
            let _ = sendto(socket, answer.as_bytes(), SendFlags::empty(), &from);
        }
        if changed {
            self.publish();
        }
    }

    /// Opens the socket of a new subscriber.
    fn open(&mut self, address: SocketAddr) -> io::Result<()> {
        let subscribers = self.subscriptions.subscribers();
        let subscriber = subscribers.iter().find(|subscriber| subscriber.address == address);
        let Some(subscriber) = subscriber.filter(|_| !self.open.contains_key(&address)) else {
            return Ok(());
        };
        let socket = open_subscriber(&self.socket, self.own, address)?;
        let socket = Arc::new(UdpSocket::from_std(socket)?);
        let mut reader = JoinSet::new();
        reader.spawn(read(Arc::clone(&socket), self.requests.clone()));
        let receiver = Receiver {
            name: address.to_string().into(),
            kind: Kind::Subscriber,
            delivery: subscriber.delivery,
            way: Some(Way { socket: Arc::clone(&socket) as _, to: address }),
            tally: Arc::default(),
        };
        self.open.insert(address, Open { socket, receiver, _reader: reader });
        Ok(())
    }

    /// Passes the list to the fast side and closes the sockets of former subscribers.
    fn publish(&mut self) {
        let now = self.subscriptions.subscribers();
        self.open.retain(|address, _| now.iter().any(|subscriber| subscriber.address == *address));
        let receivers = now.iter().filter_map(|subscriber| {
            let open = self.open.get_mut(&subscriber.address)?;
            open.receiver.delivery = subscriber.delivery;
            Some(open.receiver.clone())
        });
        let receivers: Arc<[Receiver]> = receivers.collect();
        let clients: Vec<_> = receivers.iter().map(|receiver| &*receiver.name).collect();
        tracing::info!(clients = clients.join(" "), "UDP subscriptions");
        self.list.send_replace(receivers);
    }
}

/// Reads requests without end.
async fn read(socket: Arc<UdpSocket>, to: mpsc::Sender<Request>) {
    let mut bytes = [0; LONGEST];
    let mut failing = false;
    loop {
        match socket.recv_from(&mut bytes).await {
            Ok((n, from)) => {
                failing = false;
                if to.send((from, bytes[..n].to_vec())).await.is_err() {
                    return;
                }
            }
            // The host of a subscriber has no listener any more; its lease ends.
            Err(e) if e.kind() == io::ErrorKind::ConnectionRefused => sleep(PAUSE).await,
            Err(e) => {
                if !failing {
                    tracing::warn!("cannot receive UDP subscriptions: {e}");
                }
                failing = true;
                sleep(PAUSE).await;
            }
        }
    }
}
