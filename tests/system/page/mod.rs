//! The live page of a daemon in a browser.

mod looks;
mod replay;
mod soak;
mod socket;
mod steering;
mod tools;
mod truth;

use std::net::SocketAddr;

use crate::testkit::{Browser, Daemon, Stream};

/// A free port for the page.
const ON: &str = "monitor.listen = \"127.0.0.1:0\"\n";
/// A desktop screen.
const DESK: [u32; 2] = [1280, 900];
/// The headline of a daemon without faults, whose twin or board is not calibrated.
const FINE: &str = "document.querySelector('#headline')?.dataset.grade === 'limited'
    && document.querySelector('#headline .text').textContent.startsWith('Pose valid, beam locked; limited: not calibrated')
    && !document.body.classList.contains('stale')";

/// A daemon, its stream, and the address of its page.
fn daemon(config: &str) -> (Daemon, Stream, SocketAddr) {
    let mut daemon = Daemon::start(&format!("{ON}{config}"));
    let stream = daemon.client();
    let at = daemon.monitor();
    (daemon, stream, at)
}

/// The page of a daemon without faults, open in a browser.
fn page(at: SocketAddr) -> Browser {
    let mut browser = Browser::open(&format!("http://{at}/"), DESK);
    browser.until(FINE);
    browser
}
