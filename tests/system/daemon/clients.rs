//! Clients that do not read, and clients that send invalid commands.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::testkit::{Daemon, Stream};

/// Sends invalid lines without pause and ignores all answers.
fn babble(address: SocketAddr, stop: Arc<AtomicBool>) -> std::thread::JoinHandle<usize> {
    std::thread::spawn(move || {
        let mut said = 0;
        let noise: Vec<u8> = (0..40_000_u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let mut heard = vec![0; 1 << 20];
        while !stop.load(Ordering::Relaxed) {
            // The daemon closes the connection; the client connects again.
            let mut stream = TcpStream::connect(address).unwrap();
            while stream.write_all(&noise).is_ok() && stream.read(&mut heard).is_ok_and(|n| n > 0) {
                said += noise.len();
            }
            said += noise.len();
            std::thread::sleep(Duration::from_millis(10));
        }
        said
    })
}

#[test]
fn a_client_that_never_reads_and_one_that_sends_garbage_delay_no_other_client() {
    let mut daemon = Daemon::start("publishing.tcp_queue = 256");
    let address = daemon.address();
    let mut deaf = TcpStream::connect(address).unwrap();
    deaf.write_all(b"stream\n").unwrap();
    rustix::net::sockopt::set_socket_recv_buffer_size(&deaf, 4096).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let babbler = babble(address, stop.clone());
    let gone = TcpStream::connect(address).unwrap();
    drop(gone);
    let mut streams = [Stream::tcp(address), Stream::tcp(address)];
    // These streams are checked for gaps while the buffers of the stalled client fill up and it is
    // disconnected ...
    daemon.message("disconnected: accepted no data");
    // ... and after that.
    streams[0].skip_to_now();
    streams[0].samples(500);
    let last = streams[0].next().unwrap().sequence;
    streams[1].until("as far", |f| f.sequence >= last);
    for stream in &mut streams {
        let heartbeat = stream.heartbeat();
        assert_eq!((heartbeat.dropped, stream.lost), (0, 0));
        for counter in ["scans_lost", "estimation_overflows", "tcp_overflows"] {
            assert_eq!(heartbeat.counters[counter], 0, "{counter}");
        }
        assert!(
            heartbeat.counters["tcp_dropped"] > 0,
            "the frames that the stalled client missed are counted"
        );
    }
    stop.store(true, Ordering::Relaxed);
    assert!(babbler.join().unwrap() > 100_000);
    // The stalled client does not delay the shutdown either.
    daemon.ends_in_order(rustix::process::Signal::TERM);
    drop(deaf);
}
