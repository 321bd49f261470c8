//! The task that accepts subscriptions to datagrams, on the main thread. It owns [`Subscriptions`] and the
//! socket for requests. The fast side sends frames from the same socket.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::sleep;
use tokio_util::sync::CancellationToken;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::Clock;

use super::subscription::Subscriptions;
use super::target::{Subscriber, Subscribers};
use crate::exit::Failure;

/// Longest request in bytes. The rest of a longer datagram is cut off.
const LONGEST: usize = 512;

/// The open port, before the first request.
#[derive(Debug)]
pub struct SubscriptionServer {
    socket: UdpSocket,
    list: watch::Sender<Arc<[Subscriber]>>,
}

/// Opens the port and logs its address. Also returns the sending end for the fast side.
///
/// # Errors
/// The socket cannot be opened; with [`crate::exit::IN_USE`] if another process uses the port.
pub fn open(address: SocketAddr) -> Result<(SubscriptionServer, Subscribers), Failure> {
    let open = || {
        let socket = UdpSocket::bind(address)?;
        socket.set_nonblocking(true)?;
        let sending = socket.try_clone()?;
        io::Result::Ok((socket, sending))
    };
    let (socket, sending) =
        open().map_err(|e| Failure::port(format_args!("open {address} for UDP subscriptions"), &e))?;
    let address = socket.local_addr().unwrap_or(address);
    tracing::info!(%address, "accepting UDP subscriptions");
    let (list, newest) = watch::channel([].into());
    Ok((SubscriptionServer { socket, list }, Subscribers::new(sending, newest)))
}

impl SubscriptionServer {
    /// The current subscribers.
    pub fn subscribers(&self) -> watch::Receiver<Arc<[Subscriber]>> {
        self.list.subscribe()
    }

    /// Serves requests until `stop`.
    ///
    /// # Errors
    /// The runtime does not accept the socket.
    pub async fn run(
        self,
        mut subscriptions: Subscriptions,
        clock: impl Clock,
        counters: &Counters,
        stop: CancellationToken,
    ) -> io::Result<()> {
        let socket = tokio::net::UdpSocket::from_std(self.socket)?;
        let mut bytes = [0; LONGEST];
        loop {
            let wait = subscriptions.next_end().map(|end| (end - clock.now()).max(0) as u64);
            let changed = tokio::select! {
                biased;
                () = stop.cancelled() => return Ok(()),
                () = sleep(Duration::from_nanos(wait.unwrap_or_default())), if wait.is_some() => {
                    subscriptions.expire(clock.now())
                }
                came = socket.recv_from(&mut bytes) => match came {
                    Ok((n, from)) => {
                        let outcome = subscriptions.datagram(from, &bytes[..n], clock.now());
                        if outcome.refused {
                            counters.udp_refused.inc();
                        }
                        if let Some(answer) = outcome.answer {
                            // The client repeats its request if the answer is lost.
                            let _ = socket.try_send_to(answer.as_bytes(), from);
                        }
                        outcome.changed
                    }
                    Err(e) => {
                        tracing::warn!("cannot receive a UDP subscription: {e}");
                        sleep(Duration::from_millis(100)).await;
                        false
                    }
                },
            };
            if changed {
                let now = subscriptions.subscribers();
                let clients: Vec<_> = now.iter().map(|s| s.address.to_string()).collect();
                tracing::info!(clients = clients.join(" "), "UDP subscriptions");
                self.list.send_replace(now);
            }
        }
    }
}
