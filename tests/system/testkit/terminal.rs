//! A terminal that a test opens and closes.

use std::fs::File;
use std::os::fd::OwnedFd;
use std::path::PathBuf;

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// The window of a terminal. Dropping it closes the window, as when a connection ends.
pub(crate) struct Terminal(OwnedFd);

impl Terminal {
    pub(crate) fn open() -> Self {
        let window = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&window).unwrap();
        unlockpt(&window).unwrap();
        Self(window)
    }

    /// The path of the side of the programs in it.
    pub(crate) fn name(&self) -> PathBuf {
        ptsname(&self.0, Vec::new()).unwrap().into_string().unwrap().into()
    }

    /// Sends bytes to the programs in it. Bytes for which there is no room are dropped.
    pub(crate) fn send(&self, bytes: &[u8]) {
        rustix::io::write(&self.0, bytes).unwrap();
    }

    /// Sends everything back that the programs in it write, until the last of them has closed it.
    pub(crate) fn echo(&self) {
        let mut bytes = [0; 256];
        while let Ok(n @ 1..) = rustix::io::read(&self.0, &mut bytes) {
            self.send(&bytes[..n]);
        }
    }

    /// All that is waiting to be read, after the programs in it have ended.
    pub(crate) fn text(&self) -> String {
        let (mut all, mut bytes) = (Vec::new(), [0; 4096]);
        while let Ok(n @ 1..) = rustix::io::read(&self.0, &mut bytes) {
            all.extend_from_slice(&bytes[..n]);
        }
        String::from_utf8(all).unwrap()
    }

    /// The side of the programs in it.
    pub(crate) fn inside(&self) -> File {
        let name = ptsname(&self.0, Vec::new()).unwrap();
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        rustix::fs::open(&name, flags, Mode::empty()).unwrap().into()
    }
}
