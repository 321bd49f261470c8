//! A daemon on the twin with a hand-written configuration file, and the datagrams of the daemon.

use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::ops::{Deref, DerefMut};
use std::os::unix::net::UnixStream;

use rustix::process::Signal;
use serde_json::Value;
use trifacet::client::PoseFrame;

use crate::testkit::{Daemon, Folder, PATIENCE, Udp};

/// A mirror at rest, away from the origin; no readback of the stage.
pub(crate) const AT_REST: &str = "\
[twin]
steering.readback_noise_um = \"off\"
[[twin.motion]]
axis = \"tx\"
kind = \"step\"
amount_um = 100.0
[[twin.motion]]
axis = \"yaw\"
kind = \"step\"
amount_urad = 300.0
";

pub(crate) struct Lab {
    daemon: Daemon,
    udp: Udp,
    /// The address for TCP clients.
    pub(crate) tcp: SocketAddr,
}

impl Deref for Lab {
    type Target = Daemon;

    fn deref(&self) -> &Daemon {
        &self.daemon
    }
}

impl DerefMut for Lab {
    fn deref_mut(&mut self) -> &mut Daemon {
        &mut self.daemon
    }
}

impl Lab {
    /// Starts a daemon and waits for its socket. The text must not contain `[publishing]`, `[control]`,
    /// `[monitor]` or `[log]`.
    pub(crate) fn start(text: &str) -> Self {
        let (home, udp) = (Folder::new(), Udp::open());
        let text = format!(
            "# our lab\n[publishing]\ntcp = \"127.0.0.1:0\"\nudp = [\"{}\"]\n\
             [control]\nsocket = \"{}\"\nmode = \"0640\"\n[monitor]\nlisten = \"off\"\n\
             [log]\nformat = \"json\"\n{text}",
            udp.address(),
            home.path("socket").display()
        );
        let mut daemon = Daemon::start_in(&home, &text);
        daemon.message("control socket is open");
        let tcp = daemon.address();
        Self { daemon, udp, tcp }
    }

    /// A connection to the socket, for lines that `ctl` does not send.
    pub(crate) fn connect(&self) -> (BufReader<UnixStream>, UnixStream) {
        let stream = UnixStream::connect(self.socket()).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        (BufReader::new(stream.try_clone().unwrap()), stream)
    }

    /// The next frame.
    pub(crate) fn frame(&self) -> PoseFrame {
        self.udp.frame()
    }

    /// The next frame that fulfils this condition.
    pub(crate) fn frame_with(&self, is: impl Fn(&PoseFrame) -> bool) -> PoseFrame {
        let mut frames = std::iter::repeat_with(|| self.frame()).take(60_000);
        frames.find(is).expect("such a frame in a minute")
    }

    /// Shuts the daemon down and starts it again with the current configuration file.
    pub(crate) fn restart(&mut self) {
        self.end();
        self.start_again();
    }

    /// Starts the daemon again after its end.
    pub(crate) fn start_again(&mut self) {
        self.daemon.start_again();
        self.daemon.message("control socket is open");
        self.tcp = self.daemon.address();
    }

    pub(crate) fn end(&mut self) {
        self.ends_in_order(Signal::TERM);
        assert!(!self.socket().exists(), "the socket file is removed at the end of the daemon");
        self.udp.drain(); // frames from before the end
    }
}

/// Sends a line and returns the answer.
pub(crate) fn say((read, write): &mut (BufReader<UnixStream>, UnixStream), line: &str) -> Value {
    write.write_all(line.as_bytes()).unwrap();
    let mut answer = String::new();
    read.read_line(&mut answer).unwrap();
    serde_json::from_str(&answer).unwrap()
}
