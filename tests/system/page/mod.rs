//! The live page as people see it: the real daemon, in a real browser.

mod looks;
mod replay;
mod soak;
mod socket;
mod steering;
mod truth;

use std::net::SocketAddr;

use crate::testkit::{Browser, Daemon, Stream};

/// A free port for the page.
const ON: &str = "monitor.listen = \"127.0.0.1:0\"\n";
/// A screen on a desk.
const DESK: [u32; 2] = [1280, 900];
/// The verdict of a daemon that is fine.
const FINE: &str = "document.querySelector('#verdict')?.dataset.grade === 'good' && !document.body.classList.contains('stale')";

/// A daemon, its stream, and where its page is.
fn daemon(config: &str) -> (Daemon, Stream, SocketAddr) {
    let mut daemon = Daemon::start(&format!("{ON}{config}"));
    let stream = daemon.client();
    let at = daemon.monitor();
    (daemon, stream, at)
}

/// The page of a daemon, open and fine.
fn page(at: SocketAddr) -> Browser {
    let mut browser = Browser::open(&format!("http://{at}/"), DESK);
    browser.until(FINE);
    browser
}
