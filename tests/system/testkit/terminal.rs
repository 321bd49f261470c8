//! A terminal that a test opens and closes.

use std::fs::File;
use std::os::fd::OwnedFd;

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

    /// The side of the programs in it.
    pub(crate) fn inside(&self) -> File {
        let name = ptsname(&self.0, Vec::new()).unwrap();
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        rustix::fs::open(&name, flags, Mode::empty()).unwrap().into()
    }
}
