//! The fast side of publishing: makes every frame, sends the datagrams, passes the frame to TCP and monitor.
//! Nothing here ever waits. A frame that is not accepted at once is dropped and counted.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{mpsc, watch};
use trifacet_core::estimation::PoseReport;
use trifacet_core::stamp::Stamp;
use trifacet_core::telemetry::{Counter, Counters};
use trifacet_core::time::Clock;
use trifacet_wire::stream::Descriptor;
use trifacet_wire::{PoseFrame, Status};

use super::udp;
use crate::clock::utc::Utc;

/// Distinguishes the frames of one run of a daemon with one configuration from all others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamId {
    /// Random; differs after each restart, and after each step of the time.
    pub session: u32,
    /// Hash of geometry and calibration.
    pub config: u32,
}

impl StreamId {
    /// A new session with this configuration, as computed by [`crate::config::Config::config_id`].
    pub fn new(config: u32) -> Self {
        // The standard library seeds its hash maps from the system's random numbers.
        Self { session: RandomState::new().build_hasher().finish() as u32, config }
    }
}

/// Outlets for frames. `None` disables an outlet.
#[derive(Debug)]
pub struct Outlets {
    /// The receivers of datagrams.
    pub datagrams: udp::Sender,
    /// Frames for [`super::tcp::serve`].
    pub tcp: Option<mpsc::Sender<PoseFrame>>,
    /// Frames for [`crate::monitor::http::serve`].
    pub monitor: Option<mpsc::Sender<PoseFrame>>,
    /// Set while a recording loses data.
    pub recording_fault: Arc<AtomicBool>,
    /// The descriptor, which learns of a new session.
    pub descriptor: watch::Sender<Descriptor>,
}

/// Makes frames from reports and sends them. Runs on the fast thread.
#[derive(Debug)]
pub struct Publisher<C> {
    id: StreamId,
    datagrams: udp::Sender,
    clock: C,
    utc: Utc,
    counters: Arc<Counters>,
    tcp: Option<mpsc::Sender<PoseFrame>>,
    monitor: Option<mpsc::Sender<PoseFrame>>,
    recording_fault: Arc<AtomicBool>,
    descriptor: watch::Sender<Descriptor>,
    sequence: u64,
}

impl<C: Clock> Publisher<C> {
    /// A publisher that has made no frame yet.
    pub fn new(id: StreamId, clock: C, utc: Utc, counters: Arc<Counters>, outlets: Outlets) -> Self {
        let Outlets { datagrams, tcp, monitor, recording_fault, descriptor } = outlets;
        Self { id, datagrams, clock, utc, counters, tcp, monitor, recording_fault, descriptor, sequence: 0 }
    }

    /// Sends the frame of a report to all receivers and returns it. Frames are sent at the full rate, valid
    /// or not: silence means that the link is down, and status bits give the reason for an invalid pose.
    pub fn publish(&mut self, report: &PoseReport) -> PoseFrame {
        let steps = self.utc.steps_followed();
        let (time_ns, synced) = self.utc.at(report.time, self.clock.now());
        if self.utc.steps_followed() != steps {
            self.begin_session();
        }
        self.publish_of(report, time_ns, synced)
    }

    /// As [`Publisher::publish`], with the time of the measurement in UTC, nanoseconds since 1970.
    pub fn publish_of(&mut self, report: &PoseReport, time_ns: i64, synced: bool) -> PoseFrame {
        let sent = self.clock.now();
        // From the report, not from the start: the identifier changes with the calibration, at a sample.
        let (session, config) = (self.id.session, report.config);
        let stamp = Stamp { session, config, sequence: self.sequence, time_ns, synced, sent };
        let mut frame = report.frame(stamp);
        frame.status.set(Status::RECORDING_FAULT, self.recording_fault.load(Ordering::Relaxed));
        self.sequence += 1;
        self.counters.frames.inc();
        if frame.pose[0].is_nan() {
            self.counters.frames_invalid.inc();
        }
        self.datagrams.send(&frame, &self.counters);
        hand_on(frame, self.tcp.as_ref(), &self.counters.tcp_overflows);
        hand_on(frame, self.monitor.as_ref(), &self.counters.monitor_overflows);
        frame
    }
}

impl<C> Publisher<C> {
    /// Begins a new session: differences between times of two sessions have no meaning.
    fn begin_session(&mut self) {
        self.id = StreamId::new(self.id.config);
        self.descriptor.send_modify(|descriptor| descriptor.session = self.id.session);
    }
}

/// Passes a frame to a channel. A closed channel is not a loss: the daemon notices that its reader has ended.
fn hand_on(frame: PoseFrame, to: Option<&mpsc::Sender<PoseFrame>>, overflows: &Counter) {
    if let Some(to) = to
        && let Err(TrySendError::Full(_)) = to.try_send(frame)
    {
        overflows.inc();
    }
}

#[cfg(test)]
mod tests {
    use std::net::{SocketAddr, UdpSocket};
    use std::sync::atomic::AtomicI64;
    use std::time::Duration;

    use trifacet_core::time::Mono;
    use trifacet_core::utc::Reading;

    use super::*;
    use crate::config::UdpTarget;
    use crate::publishing::descriptor::StreamFacts;

    #[derive(Clone)]
    struct Fixed(Mono);

    impl Clock for Fixed {
        fn now(&self) -> Mono {
            self.0
        }
    }

    fn outlets() -> Outlets {
        let facts = StreamFacts::example(StreamId { session: 1, config: 2 });
        Outlets {
            datagrams: udp::Sender::new([udp::Supervisor::new(&[], None).targets()]),
            tcp: None,
            monitor: None,
            recording_fault: Arc::default(),
            descriptor: watch::Sender::new(facts.descriptor()),
        }
    }

    fn publisher(udp: Vec<SocketAddr>, tcp: Option<mpsc::Sender<PoseFrame>>) -> Publisher<Fixed> {
        let udp: Vec<_> = udp.into_iter().map(UdpTarget::to).collect();
        publisher_to(&udp, tcp, || (Mono(0), 5_000_000_000))
    }

    fn publisher_to(
        udp: &[UdpTarget],
        tcp: Option<mpsc::Sender<PoseFrame>>,
        utc: fn() -> Reading,
    ) -> Publisher<Fixed> {
        let datagrams = udp::Sender::new([udp::Supervisor::new(udp, None).targets()]);
        let outlets = Outlets { datagrams, tcp, ..outlets() };
        let id = StreamId { session: 1, config: 2 };
        Publisher::new(id, Fixed(Mono(1_200_000)), Utc::reading(utc), Arc::default(), outlets)
    }

    #[test]
    fn a_datagram_arrives_with_the_time_of_acquisition() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        receiver.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let unreachable = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let mut publisher = publisher(vec![unreachable, receiver.local_addr().unwrap()], None);
        for sequence in 0..3 {
            publisher.publish(&PoseReport::example());
            let mut bytes = [0; 300];
            let n = receiver.recv(&mut bytes).unwrap();
            let frame = PoseFrame::decode(&bytes[..n]).unwrap();
            assert_eq!(
                (frame.session, frame.config, frame.sequence),
                (1, PoseReport::example().config, sequence)
            );
            assert_eq!(frame.time_ns, 5_001_000_000, "not the time of transmission");
            assert_eq!(frame.send_delay_ns, 200_000);
        }
        assert_eq!(publisher.counters.udp_dropped.get(), 0, "a target without a listener is not a loss");
    }

    #[test]
    fn each_target_gets_its_frames_in_its_format() {
        let receivers = [(); 3].map(|()| {
            let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
            socket.set_nonblocking(true).unwrap();
            socket
        });
        let [plain, big, held] = receivers.each_ref().map(|r| UdpTarget::to(r.local_addr().unwrap()));
        let targets = [
            UdpTarget { divider: 2, ..plain },
            UdpTarget { big_endian: true, ..big },
            UdpTarget { held: true, divider: 3, ..held },
        ];
        let mut publisher = publisher_to(&targets, None, || (Mono(0), 0));
        for n in 0..6 {
            let status = if n < 2 { PoseReport::example().status } else { Status::PSD_A_LOW };
            publisher.publish(&PoseReport { status, ..PoseReport::example() });
        }
        let [plain, big, held] = receivers.map(|receiver| {
            let mut bytes = [0; 300];
            let next = || receiver.recv(&mut bytes).ok().map(|n| bytes[..n].to_vec());
            std::iter::from_fn(next).collect::<Vec<_>>()
        });
        let decode = |all: &[Vec<u8>]| -> Vec<_> {
            all.iter().map(|bytes| PoseFrame::decode_either(bytes).unwrap()).collect()
        };
        let sequences = |all| -> Vec<_> { decode(all).iter().map(|frame| frame.sequence).collect() };
        assert_eq!(sequences(&plain), [0, 2, 4]);
        assert_eq!(sequences(&big), [0, 1, 2, 3, 4, 5]);
        assert!(PoseFrame::decode(&big[0]).is_err() && decode(&big)[5].pose[0].is_nan());
        assert_eq!(sequences(&held), [0, 3]);
        let last = decode(&held)[1];
        assert_eq!((last.status, last.pose[0]), (Status::PSD_A_LOW | Status::POSE_HELD, 1e-6));
        assert!(decode(&plain)[2].pose[0].is_nan());
    }

    #[test]
    fn datagrams_that_cannot_be_sent_are_counted() {
        let no_port = SocketAddr::from(([127, 0, 0, 1], 0));
        let mut publisher = publisher(vec![no_port], None);
        publisher.publish(&PoseReport::example());
        assert_eq!(publisher.counters.udp_dropped.get(), 1);
    }

    #[test]
    fn a_full_tcp_side_loses_frames_that_are_counted_and_the_sequence_shows_it() {
        let (tx, mut rx) = mpsc::channel(2);
        let mut publisher = publisher(vec![], Some(tx));
        for _ in 0..5 {
            publisher.publish(&PoseReport::example());
        }
        assert_eq!(publisher.counters.tcp_overflows.get(), 3);
        rx.try_recv().unwrap();
        publisher.publish(&PoseReport::example());
        let sequence = |frame: PoseFrame| frame.sequence;
        assert_eq!([rx.try_recv().map(sequence), rx.try_recv().map(sequence)], [Ok(1), Ok(5)]);
    }

    #[test]
    fn invalid_reports_are_published_too() {
        let (tx, mut rx) = mpsc::channel(2);
        let mut publisher = publisher(vec![], Some(tx));
        publisher.publish(&PoseReport { pose: None, status: Status::SOURCE_DOWN, ..PoseReport::example() });
        let frame = rx.try_recv().unwrap();
        assert_eq!(frame.status, Status::SOURCE_DOWN);
        assert_eq!((publisher.counters.frames.get(), publisher.counters.frames_invalid.get()), (1, 1));
    }

    #[test]
    fn every_start_is_another_session() {
        assert_ne!(StreamId::new(1).session, StreamId::new(1).session);
    }

    #[test]
    fn a_step_of_the_system_clock_begins_a_new_session() {
        #[derive(Clone)]
        struct Ticking(Arc<AtomicI64>);
        impl Clock for Ticking {
            fn now(&self) -> Mono {
                Mono(self.0.load(Ordering::Relaxed))
            }
        }
        /// The system clock is an hour ahead from the second reading on.
        fn read() -> (Mono, i64) {
            static CALLS: AtomicI64 = AtomicI64::new(0);
            let n = CALLS.fetch_add(1, Ordering::Relaxed);
            let step_s = if n == 0 { 0 } else { 3600 };
            (Mono(n * 1_000_000_000), (1_800_000_000 + n + step_s) * 1_000_000_000)
        }
        let clock = Ticking(Arc::default());
        let id = StreamId { session: 1, config: 2 };
        let outlets = outlets();
        let descriptor = outlets.descriptor.subscribe();
        let utc = Utc::reading(read);
        let mut publisher = Publisher::new(id, clock.clone(), utc, Arc::default(), outlets);
        let mut frame = |s: i64| {
            clock.0.store(s * 1_000_000_000, Ordering::Relaxed);
            publisher.publish(&PoseReport { time: Mono(s * 1_000_000_000), ..PoseReport::example() })
        };
        assert_eq!(frame(0).session, 1);
        let unconfirmed = frame(1);
        assert!(unconfirmed.session == 1 && unconfirmed.status.has(Status::CLOCK_UNSYNCED));
        let followed = frame(2);
        assert!(followed.session != 1 && !followed.status.has(Status::CLOCK_UNSYNCED));
        assert_eq!(followed.time_ns, (1_800_000_002 + 3600) * 1_000_000_000);
        assert_eq!(descriptor.borrow().session, followed.session);
        assert_eq!(frame(3).session, followed.session);
    }
}
