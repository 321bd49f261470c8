//! Opens a serial port exclusively. If this fails, finds the process that uses it, the missing permission, or the
//! device under its new name.

mod devices;
mod permission;

use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::{fs, io};

pub use devices::Identity;
use serialport::TTYPort;

/// Reasons why a port cannot be opened.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PortError {
    /// Another process uses the port.
    #[error("{} is in use by {holder}", .port.display())]
    InUse {
        /// Path of the port.
        port: PathBuf,
        /// Id and name of that process.
        holder: String,
    },
    /// Any other error; it may be temporary.
    #[error("{}: {reason}", .port.display())]
    Other {
        /// Path of the port.
        port: PathBuf,
        /// Error message of the system.
        reason: String,
    },
}

impl PortError {
    /// The reason, without the name of the port.
    pub fn reason(&self) -> String {
        match self {
            Self::InUse { holder, .. } => format!("in use by {holder}"),
            Self::Other { reason, .. } => reason.clone(),
        }
    }
}

/// An open port.
#[derive(Debug)]
pub struct Opened {
    /// The port.
    pub tty: TTYPort,
    /// What is known of the device, to find it again under another name.
    pub identity: Identity,
}

/// Opens the port raw, 8N1, without flow control, exclusively, and discards the contents of its buffers.
/// Blocks while the system opens the device. If the port does not exist, the message points at the device with the
/// identity `last`, if there is one, or at the devices that exist.
///
/// Two locks keep other processes out: the exclusive mode of the terminal, which root can override, and an
/// advisory lock on the file, for processes that check it. A process that opened the port earlier is found in
/// `/proc`.
///
/// # Errors
/// Another process uses the port, or the path is not a serial port, or the system reports an error.
pub fn open(port: &Path, baud: u32, last: &Identity) -> Result<Opened, PortError> {
    let other = |reason: String| PortError::Other { port: port.to_owned(), reason };
    let in_use = |holder| PortError::InUse { port: port.to_owned(), holder };
    // The target of a link may change: only this name is kept.
    let device = fs::canonicalize(port).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => other(format!("does not exist; {}", devices::pointer(port, last))),
        _ => other(error.to_string()),
    })?;
    let metadata = fs::metadata(&device).map_err(|error| other(error.to_string()))?;
    let no_port = || other("is not a serial port".into());
    if !metadata.file_type().is_char_device() {
        return Err(no_port());
    }
    if let Some(holder) = holders(metadata.rdev()) {
        return Err(if is_terminal(&device) { in_use(holder) } else { no_port() });
    }
    let builder = serialport::new(device.to_string_lossy(), baud).exclusive(true);
    let tty = TTYPort::open(&builder).map_err(|error| match error.kind() {
        _ if !is_terminal(&device) => no_port(),
        serialport::ErrorKind::NoDevice => {
            let found = holders(metadata.rdev()).or_else(|| lock_owner(&metadata));
            in_use(found.unwrap_or_else(|| "a process that this user cannot see".into()))
        }
        serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied) => other(permission::explain(&metadata)),
        _ => other(error.to_string()),
    })?;
    serialport::SerialPort::clear(&tty, serialport::ClearBuffer::All)
        .map_err(|error| other(error.to_string()))?;
    Ok(Opened { tty, identity: Identity::of(&device) })
}

/// Whether a character device is a terminal, as serial ports are. A device that cannot be opened for this
/// check, such as a port with exclusive access, counts as a terminal.
fn is_terminal(device: &Path) -> bool {
    use rustix::fs::{Mode, OFlags};
    let flags = OFlags::RDONLY | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    rustix::fs::open(device, flags, Mode::empty()).map_or(true, rustix::termios::isatty)
}

/// The processes that have the character device `rdev` open, as far as this user can see them.
fn holders(rdev: u64) -> Option<String> {
    let holds = |pid: &u32| {
        let files = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
        files.filter_map(|file| fs::metadata(file.path()).ok()).any(|file| is_device(&file, rdev))
    };
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let pids = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let found: Vec<_> = pids.filter(holds).map(process).collect();
    (!found.is_empty()).then(|| found.join(", "))
}

fn is_device(file: &fs::Metadata, rdev: u64) -> bool {
    file.file_type().is_char_device() && file.rdev() == rdev
}

/// The process that holds the advisory lock on a file. The list of locks is readable for every user; the open
/// files of other users are not.
fn lock_owner(file: &fs::Metadata) -> Option<String> {
    let (major, minor) = (rustix::fs::major(file.dev()), rustix::fs::minor(file.dev()));
    let wanted = format!("{major:02x}:{minor:02x}:{}", file.ino());
    let locks = fs::read_to_string("/proc/locks").ok()?;
    let line = locks.lines().find(|line| line.split_whitespace().any(|field| field == wanted))?;
    line.split_whitespace().nth(4)?.parse().ok().map(process)
}

/// Id and name of a process.
pub fn process(pid: u32) -> String {
    let name = fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
    format!("process {pid} ({})", name.trim())
}

#[cfg(test)]
mod tests {
    use std::os::fd::OwnedFd;

    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

    use super::*;

    fn pty() -> (OwnedFd, PathBuf) {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap();
        (master, PathBuf::from(name.to_str().unwrap()))
    }

    #[test]
    fn a_port_is_opened_once_and_the_second_attempt_names_its_owner() {
        let (_master, path) = pty();
        let first = open(&path, 921_600, &Identity::default()).unwrap();
        let me = format!("process {} (", std::process::id());
        match open(&path, 921_600, &Identity::default()) {
            Err(PortError::InUse { holder, .. }) => assert!(holder.starts_with(&me), "{holder}"),
            other => panic!("{other:?}"),
        }
        let owner = lock_owner(&fs::metadata(&path).unwrap());
        assert!(owner.is_some_and(|owner| owner.starts_with(&me)));
        drop(first);
        open(&path, 921_600, &Identity::default()).unwrap();
    }

    #[test]
    fn a_process_that_does_not_lock_the_port_is_found_too() {
        let (_master, path) = pty();
        let reader = fs::File::open(&path).unwrap();
        assert!(matches!(open(&path, 921_600, &Identity::default()), Err(PortError::InUse { .. })));
        drop(reader);
        open(&path, 921_600, &Identity::default()).unwrap();
    }

    #[test]
    fn a_file_that_is_not_a_port_is_reported() {
        let missing = open(Path::new("/nowhere/port"), 921_600, &Identity::default()).unwrap_err();
        assert!(missing.to_string().contains("/nowhere/port"), "{missing}");
        let file = tempfile::NamedTempFile::new().unwrap();
        // A device that is not a terminal: this process has the first one open, and no process the other one.
        let _null = fs::File::open("/dev/null").unwrap();
        for no_port in [file.path(), Path::new("/dev/null"), Path::new("/dev/full")] {
            let error = open(no_port, 921_600, &Identity::default()).unwrap_err();
            assert!(error.to_string().ends_with("is not a serial port"), "{error}");
        }
    }
}
