//! The master side of a pseudo-terminal: the line of an emulated board.

use std::future::poll_fn;
use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use tokio::io::unix::AsyncFd;
use trifacet_core::time::Clock;

use super::Emulator;

/// Interval of the checks whether the other side is open.
const LOOK: Duration = Duration::from_millis(20);

/// A pseudo-terminal whose slave side a host may open, close and open again.
#[derive(Debug)]
pub struct Pty {
    master: Arc<OwnedFd>,
    /// Present while the other side is open. After a hang-up the reactor would report nothing else any more,
    /// so the descriptor is registered again for each host.
    host: Option<AsyncFd<Arc<OwnedFd>>>,
    path: PathBuf,
    buffer: [u8; 1024],
}

impl Pty {
    /// A new pseudo-terminal, in raw mode from the start so that nothing is echoed.
    ///
    /// # Errors
    /// The system provides no pseudo-terminal.
    pub fn open() -> io::Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        rustix::io::ioctl_fionbio(&master, true)?;
        let name = ptsname(&master, Vec::new())?;
        let slave = rustix::fs::open(&name, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
        let mut termios = tcgetattr(&slave)?;
        termios.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &termios)?;
        let path = PathBuf::from(name.to_string_lossy().into_owned());
        Ok(Self { master: Arc::new(master), host: None, path, buffer: [0; 1024] })
    }

    /// Path of the slave side.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Transfers bytes to and from the board until some have arrived for it. Cancel-safe. Needs a tokio
    /// runtime.
    ///
    /// # Errors
    /// The system reports an error other than a hang-up.
    pub async fn exchange(&mut self, board: &mut Emulator, clock: &impl Clock) -> io::Result<()> {
        loop {
            self.look()?;
            let Some(host) = &self.host else {
                board.unheard();
                tokio::time::sleep(LOOK).await;
                continue;
            };
            match poll_fn(|cx| poll_exchange(host, &mut self.buffer, board, cx)).await {
                Ok(read) => {
                    board.received(&self.buffer[..read], clock.now());
                    return Ok(());
                }
                Err(error) if error.raw_os_error() == Some(Errno::IO.raw_os_error()) => self.host = None,
                Err(error) => return Err(error),
            }
        }
    }

    /// Registers the descriptor if the other side has been opened.
    #[expect(
        deprecated,
        reason = "the replacement is unsafe because a descriptor may change; an owned one that is never replaced cannot"
    )]
    fn look(&mut self) -> io::Result<()> {
        if self.host.is_none() && is_open(&self.master)? {
            self.host = Some(AsyncFd::new(Arc::clone(&self.master))?);
        }
        Ok(())
    }
}

/// Whether the other side is open.
fn is_open(master: &OwnedFd) -> io::Result<bool> {
    let mut fds = [PollFd::new(master, PollFlags::IN)];
    poll(&mut fds, Some(&Timespec::default()))?;
    Ok(!fds[0].revents().contains(PollFlags::HUP))
}

/// Reads if data is available; writes the output of the board.
fn poll_exchange(
    host: &AsyncFd<Arc<OwnedFd>>,
    buffer: &mut [u8],
    board: &mut Emulator,
    cx: &mut Context,
) -> Poll<io::Result<usize>> {
    while let Poll::Ready(ready) = host.poll_read_ready(cx) {
        if let Ok(read) = ready?.try_io(|fd| Ok(rustix::io::read(fd, &mut *buffer)?)) {
            return Poll::Ready(read);
        }
    }
    while !board.output().is_empty() {
        let mut ready = ready!(host.poll_write_ready(cx))?;
        match ready.try_io(|fd| Ok(rustix::io::write(fd, board.output())?)) {
            Ok(Ok(written)) => board.written(written),
            Ok(Err(error)) => return Poll::Ready(Err(error)),
            Err(_would_block) => {}
        }
    }
    Poll::Pending
}
