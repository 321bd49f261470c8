//! The fast side of publishing: makes every frame, sends the datagrams, hands the frame on to TCP.
//! Nothing here ever waits; what is not taken at once is dropped and counted.

use std::{
    hash::{BuildHasher, Hasher, RandomState},
    io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket},
    sync::Arc,
};

use tokio::sync::mpsc::{self, error::TrySendError};

use super::{
    frame::{FrameBytes, PoseFrame},
    stamp::Stamp,
};
use crate::{
    clock::{Clock, utc::Utc},
    estimation::PoseReport,
    exit::{self, Failure},
    monitor::Counters,
};

/// What tells the frames of one daemon, with one configuration, from all others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamId {
    /// Random: another one after a restart.
    pub session: u32,
    /// Hash of geometry and calibration.
    pub config: u32,
}

impl StreamId {
    /// A new session with this configuration, as [`crate::config::Config::config_id`] tells it.
    pub fn new(config: u32) -> Self {
        // The standard library seeds its hash maps from the system's random numbers.
        Self { session: RandomState::new().build_hasher().finish() as u32, config }
    }
}

/// What a [`Publisher`] needs to know.
#[derive(Clone, Debug)]
pub struct PublisherSettings {
    /// Goes into every frame.
    pub id: StreamId,
    /// Where datagrams go.
    pub udp: Vec<SocketAddr>,
}

/// Makes frames of reports and gives them to the network. Lives on the fast thread.
#[derive(Debug)]
pub struct Publisher<C> {
    id: StreamId,
    targets: Vec<Target>,
    clock: C,
    utc: Utc,
    counters: Arc<Counters>,
    tcp: Option<mpsc::Sender<PoseFrame>>,
    sequence: u64,
}

#[derive(Debug)]
struct Target {
    address: SocketAddr,
    socket: UdpSocket,
    /// The last sending failed: says once that, and once that it works again.
    failing: bool,
}

impl<C: Clock> Publisher<C> {
    /// A publisher with its sockets. `tcp` leads to [`super::tcp::serve`], if that runs.
    ///
    /// Fails if no socket can be had.
    pub fn new(
        settings: PublisherSettings,
        clock: C,
        utc: Utc,
        counters: Arc<Counters>,
        tcp: Option<mpsc::Sender<PoseFrame>>,
    ) -> Result<Self, Failure> {
        let targets = settings.udp.into_iter().map(Target::open).collect::<Result<_, _>>()?;
        Ok(Self { id: settings.id, targets, clock, utc, counters, tcp, sequence: 0 })
    }

    /// Sends the frame of a report to everyone. Frames go out at the full rate, valid or not: silence
    /// means that the link is down, a status bit means why the optics are.
    pub fn publish(&mut self, report: &PoseReport) {
        let sent = self.clock.now();
        let (time_ns, synced) = self.utc.at(report.time, sent);
        let StreamId { session, config } = self.id;
        let stamp = Stamp { session, config, sequence: self.sequence, time_ns, synced, sent };
        let frame = PoseFrame::from_report(report, stamp);
        self.sequence += 1;
        self.counters.frames.one();
        if frame.pose[0].is_nan() {
            self.counters.frames_invalid.one();
        }
        let bytes = frame.encode();
        for target in &mut self.targets {
            target.send(&bytes, &self.counters);
        }
        // A closed channel is not a loss: it means that the TCP side has ended, which the daemon sees.
        if let Some(tcp) = &self.tcp
            && let Err(TrySendError::Full(_)) = tcp.try_send(frame)
        {
            self.counters.tcp_overflows.one();
        }
    }
}

impl Target {
    /// A socket per target, left unconnected: so the refusal of one that nobody listens to stays unseen,
    /// and starting the listener later just works.
    fn open(address: SocketAddr) -> Result<Self, Failure> {
        let local: SocketAddr = match address {
            SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
            SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
        };
        let open = || {
            let socket = UdpSocket::bind(local)?;
            socket.set_nonblocking(true)?;
            socket.set_broadcast(address.is_ipv4())?;
            Ok(socket)
        };
        let socket = open().map_err(|e: io::Error| {
            Failure::new(exit::IO, format!("cannot open a UDP socket towards {address}: {e}"))
        })?;
        Ok(Self { address, socket, failing: false })
    }

    fn send(&mut self, bytes: &FrameBytes, counters: &Counters) {
        let failure = match self.socket.send_to(bytes, self.address) {
            Ok(_) => None,
            Err(e) if e.kind() == io::ErrorKind::ConnectionRefused => None,
            Err(e) => Some(e),
        };
        if failure.is_some() {
            counters.udp_dropped.one();
        }
        match (self.failing, failure) {
            (false, Some(e)) => {
                self.failing = true;
                tracing::warn!(target = %self.address, "datagrams are not sent (udp_dropped counts them): {e}");
            }
            (true, None) => {
                self.failing = false;
                tracing::info!(target = %self.address, "datagrams are sent again");
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::{clock::Mono, estimation::Status, publishing::stamp::tests::report};

    #[derive(Clone)]
    struct Fixed(Mono);

    impl Clock for Fixed {
        fn now(&self) -> Mono {
            self.0
        }
    }

    fn publisher(udp: Vec<SocketAddr>, tcp: Option<mpsc::Sender<PoseFrame>>) -> Publisher<Fixed> {
        let settings = PublisherSettings { id: StreamId { session: 1, config: 2 }, udp };
        let utc = Utc::reading(|| (Mono(0), 5_000_000_000));
        Publisher::new(settings, Fixed(Mono(1_200_000)), utc, Arc::default(), tcp).unwrap()
    }

    #[test]
    fn a_datagram_arrives_with_the_time_of_acquisition() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        receiver.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let nobody = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let mut publisher = publisher(vec![nobody, receiver.local_addr().unwrap()], None);
        for sequence in 0..3 {
            publisher.publish(&report());
            let mut bytes = [0; 300];
            let n = receiver.recv(&mut bytes).unwrap();
            let frame = PoseFrame::decode(&bytes[..n]).unwrap();
            assert_eq!((frame.session, frame.config, frame.sequence), (1, 2, sequence));
            assert_eq!(frame.time_ns, 5_001_000_000, "not the time of sending");
            assert_eq!(frame.send_delay_ns, 200_000);
        }
        assert_eq!(publisher.counters.udp_dropped.get(), 0, "that nobody listens is not a loss");
    }

    #[test]
    fn what_the_network_does_not_take_is_counted() {
        let no_port = SocketAddr::from(([127, 0, 0, 1], 0));
        let mut publisher = publisher(vec![no_port], None);
        publisher.publish(&report());
        assert_eq!(publisher.counters.udp_dropped.get(), 1);
    }

    #[test]
    fn a_full_tcp_side_loses_frames_that_are_counted_and_the_sequence_shows_it() {
        let (tx, mut rx) = mpsc::channel(2);
        let mut publisher = publisher(vec![], Some(tx));
        for _ in 0..5 {
            publisher.publish(&report());
        }
        assert_eq!(publisher.counters.tcp_overflows.get(), 3);
        rx.try_recv().unwrap();
        publisher.publish(&report());
        let sequence = |frame: PoseFrame| frame.sequence;
        assert_eq!([rx.try_recv().map(sequence), rx.try_recv().map(sequence)], [Ok(1), Ok(5)]);
    }

    #[test]
    fn invalid_reports_are_published_too() {
        let (tx, mut rx) = mpsc::channel(2);
        let mut publisher = publisher(vec![], Some(tx));
        publisher.publish(&PoseReport { pose: None, status: Status::SOURCE_DOWN, ..report() });
        let frame = rx.try_recv().unwrap();
        assert_eq!(frame.status, Status::SOURCE_DOWN);
        assert_eq!((publisher.counters.frames.get(), publisher.counters.frames_invalid.get()), (1, 1));
    }

    #[test]
    fn every_start_is_another_session() {
        assert_ne!(StreamId::new(1).session, StreamId::new(1).session);
    }
}
