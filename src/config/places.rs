//! Where the control socket and the recordings are if the configuration does not say it.
//!
//! A service has the folders that systemd made for it (`RUNTIME_DIRECTORY`, `STATE_DIRECTORY`). A program that a
//! person starts uses the folders of the XDG Base Directory Specification, which belong to this person alone.

use std::env;
use std::path::PathBuf;

use rustix::process::geteuid;

/// The value of a key that leaves the choice to this module.
pub const AUTO: &str = "auto";
/// The control socket of the service.
pub const SERVICE_SOCKET: &str = "/run/trifacet/control.sock";
/// The recordings of the service.
const SERVICE_RECORDINGS: &str = "/var/lib/trifacet/recordings";

/// The control socket: in the folder of the service; else below `$XDG_RUNTIME_DIR`, if this folder exists; for
/// root without such a folder, that of the service. `None`: there is no folder that belongs to this user alone.
pub fn control_socket() -> Option<PathBuf> {
    let service = folder("RUNTIME_DIRECTORY").map(|folder| folder.join("control.sock"));
    let session = || {
        let folder = folder("XDG_RUNTIME_DIR")?;
        Some(folder.is_dir().then(|| folder.join("trifacet/control.sock")))
    };
    let root = || geteuid().is_root().then(|| SERVICE_SOCKET.into());
    service.or_else(|| session().unwrap_or_else(root))
}

/// The recordings: in the folder of the service; else below `$XDG_DATA_HOME`, or `~/.local/share` without it.
pub fn recordings() -> PathBuf {
    let service = folder("STATE_DIRECTORY").map(|folder| folder.join("recordings"));
    service.or_else(own_recordings).unwrap_or_else(|| SERVICE_RECORDINGS.into())
}

/// The recordings of a person.
fn own_recordings() -> Option<PathBuf> {
    let home = || folder("HOME").map(|home| home.join(".local/share"));
    Some(folder("XDG_DATA_HOME").or_else(home)?.join("trifacet/recordings"))
}

/// Whether this module chose the place, so that missing folders above it are created.
pub fn is_own(path: &std::path::Path) -> bool {
    Some(path) == control_socket().as_deref() || Some(path) == own_recordings().as_deref()
}

/// An absolute path in the environment; of several ones, the first. Relative ones are ignored, as the
/// specification demands.
fn folder(variable: &str) -> Option<PathBuf> {
    let value = env::var_os(variable)?;
    let first = env::split_paths(&value).next()?;
    first.is_absolute().then_some(first)
}
