//! Messages of a service to systemd (`sd_notify(3)`): datagrams with one or more lines, to the socket that
//! systemd names. Without systemd there is no socket, and nothing is sent.

use std::cell::{Cell, RefCell};
use std::ffi::OsStr;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::Duration;

use trifacet_core::time::Clock;

use crate::clock::SystemClock;

/// Sends messages to systemd.
#[derive(Debug, Default)]
pub struct Notify {
    socket: Option<UnixDatagram>,
    watchdog: Option<Duration>,
    ready: Cell<bool>,
    ending: Cell<bool>,
    status: RefCell<String>,
}

impl Notify {
    /// Uses the environment (`NOTIFY_SOCKET`, `WATCHDOG_USEC`, `WATCHDOG_PID`). Without it, sends nothing.
    pub fn from_environment() -> Self {
        let Some(name) = std::env::var_os("NOTIFY_SOCKET").filter(|name| !name.is_empty()) else {
            return Self::default();
        };
        let socket = connect(&name)
            .inspect_err(|error| tracing::warn!(%error, ?name, "cannot talk to systemd (NOTIFY_SOCKET)"))
            .ok();
        let number = |name| std::env::var(name).ok()?.parse::<u64>().ok();
        let for_another = number("WATCHDOG_PID").is_some_and(|pid| pid != u64::from(std::process::id()));
        let usec = number("WATCHDOG_USEC").filter(|usec| *usec > 0 && !for_another);
        Self { watchdog: usec.map(Duration::from_micros), socket, ..Self::default() }
    }

    /// Interval within which systemd expects `WATCHDOG=1`.
    pub fn watchdog(&self) -> Option<Duration> {
        self.watchdog
    }

    /// Reports that there are frames. Sent once.
    pub fn ready(&self) {
        if !self.ready.replace(true) {
            self.send("READY=1");
        }
    }

    /// Reports that every task has a heartbeat.
    pub fn alive(&self) {
        if self.watchdog.is_some() {
            self.send("WATCHDOG=1");
        }
    }

    /// Sends a line of status if it has changed.
    pub fn status(&self, line: &str) {
        if *self.status.borrow() != line && !self.ending.get() {
            line.clone_into(&mut self.status.borrow_mut());
            self.send(&format!("STATUS={line}"));
        }
    }

    /// Reports that the configuration is being read again, until [`Notify::reloaded`].
    pub fn reloading(&self) {
        if self.ready.get() {
            let now_us = SystemClock.now().0 / 1000;
            self.send(&format!("RELOADING=1\nMONOTONIC_USEC={now_us}"));
        }
    }

    /// Reports that it has been read, whatever the result.
    pub fn reloaded(&self) {
        if self.ready.get() {
            self.send("READY=1");
        }
    }

    /// Reports that the daemon is stopping.
    pub fn stopping(&self) {
        self.send("STOPPING=1\nSTATUS=stopping");
        self.ending.set(true);
    }

    fn send(&self, text: &str) {
        if let Some(socket) = &self.socket
            && let Err(error) = socket.send(text.as_bytes())
        {
            tracing::warn!(%error, text, "cannot send a message to systemd");
        }
    }
}

/// Connects to a socket in the file system, or in the abstract namespace (`@name`). Sending never waits.
fn connect(name: &OsStr) -> io::Result<UnixDatagram> {
    let address = match name.as_bytes() {
        [b'@', name @ ..] => SocketAddr::from_abstract_name(name)?,
        _ => SocketAddr::from_pathname(name)?,
    };
    let socket = UnixDatagram::unbound()?;
    socket.connect_addr(&address)?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notifications_are_sent_once_and_a_reload_only_after_ready() {
        let name = format!("trifacet-notify-{}", std::process::id());
        let systemd = UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name).unwrap()).unwrap();
        systemd.set_nonblocking(true).unwrap();
        let next_message = || {
            let mut bytes = [0; 200];
            systemd.recv(&mut bytes).map(|n| String::from_utf8_lossy(&bytes[..n]).into_owned()).ok()
        };
        let socket = connect(OsStr::new(&format!("@{name}"))).unwrap();
        let notify = Notify { socket: Some(socket), ..Notify::default() };
        notify.reloading();
        notify.alive();
        assert_eq!(next_message(), None, "not ready, and no watchdog is configured");
        notify.ready();
        notify.ready();
        notify.status("a");
        notify.status("a");
        notify.status("b");
        assert_eq!(
            [next_message(), next_message(), next_message()].map(Option::unwrap),
            ["READY=1", "STATUS=a", "STATUS=b"]
        );
        notify.reloading();
        notify.reloaded();
        assert!(next_message().unwrap().starts_with("RELOADING=1\nMONOTONIC_USEC="));
        assert_eq!(next_message().unwrap(), "READY=1");
        notify.stopping();
        notify.status("locked");
        assert_eq!(next_message().unwrap(), "STOPPING=1\nSTATUS=stopping");
        assert_eq!(next_message(), None);
    }
}
