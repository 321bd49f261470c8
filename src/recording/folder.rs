//! The folder of the recordings: file names, free space.

use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use rustix::fs::{Access, access, statvfs};

use crate::config::places;

/// Extension of an unfinished file.
pub const UNFINISHED: &str = "part";
/// Permissions of a file, before the umask.
const MODE: u32 = 0o640;
/// Permissions of the folder, before the umask.
const FOLDER_MODE: u32 = 0o750;

/// A folder of recordings. Other files in it are left alone.
#[derive(Clone, Debug)]
pub struct Folder(pub PathBuf);

/// A recording in the folder.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Recording {
    /// Its path. Paths sort by the start time, according to the clock of that time.
    pub path: PathBuf,
    /// Its size in bytes.
    pub bytes: u64,
}

impl Recording {
    /// Whether it is unfinished.
    pub fn unfinished(&self) -> bool {
        self.path.extension().is_some_and(|extension| extension == UNFINISHED)
    }

    /// Its path when it is finished.
    pub fn finished(&self) -> PathBuf {
        if self.unfinished() { self.path.with_extension("") } else { self.path.clone() }
    }

    /// Whether a process is writing it, this one or another. If that cannot be determined: true.
    pub fn in_use(&self) -> bool {
        let locked = |file: File| file.try_lock().is_err();
        self.unfinished() && OpenOptions::new().write(true).open(&self.path).map_or(true, locked)
    }
}

/// Why recordings cannot be written to a folder.
#[derive(Debug, thiserror::Error)]
pub enum UnusableFolder {
    /// The path leads to something else.
    #[error("it is not a folder")]
    NotFolder,
    /// The path cannot be examined.
    #[error("{0}")]
    Unreadable(io::Error),
    /// The folder does not exist, and cannot be created in its parent.
    #[error("folder {} does not exist, and only the last folder of the path is created", parent.display())]
    NoParent {
        /// The parent.
        parent: PathBuf,
    },
    /// The user has no permission to write.
    #[error("cannot write to {}: {source}", folder.display())]
    NoPermission {
        /// The folder, or its parent if the folder does not exist.
        folder: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
}

impl Folder {
    /// Creates the folder if it does not exist. Its parent must exist.
    ///
    /// # Errors
    /// The folder cannot be created.
    pub fn make(&self) -> io::Result<()> {
        // The folders above are made only in the home of the user: a missing one elsewhere may be a disk that is not
        // mounted.
        match DirBuilder::new().recursive(places::is_own(&self.0)).mode(FOLDER_MODE).create(&self.0) {
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => Ok(()),
            made => made,
        }
    }

    /// Checks whether recordings can be written here, without creating anything.
    ///
    /// # Errors
    /// The path is not a folder, its parent does not exist, or there is no permission to write.
    pub fn usable(&self) -> Result<(), UnusableFolder> {
        let parent = self.0.parent().filter(|parent| !parent.as_os_str().is_empty());
        let parent = match parent.unwrap_or(Path::new(".")) {
            // These are made with the folder.
            parent if places::is_own(&self.0) => parent.ancestors().find(|it| it.is_dir()).unwrap_or(parent),
            parent => parent,
        };
        let there = match fs::metadata(&self.0) {
            Ok(it) if it.is_dir() => &self.0,
            Ok(_) => return Err(UnusableFolder::NotFolder),
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(UnusableFolder::Unreadable(e)),
            Err(_) if !parent.is_dir() => {
                return Err(UnusableFolder::NoParent { parent: parent.to_owned() });
            }
            Err(_) => parent,
        };
        let may = access(there, Access::WRITE_OK | Access::EXEC_OK);
        may.map_err(|e| UnusableFolder::NoPermission { folder: there.to_owned(), source: e.into() })
    }

    /// Creates the file of a recording that begins at this time, UTC. The file is locked while it is open, so
    /// that [`Recording::in_use`] is true for it.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(&self, mut time_ns: i64) -> io::Result<(File, PathBuf)> {
        loop {
            let path = self.0.join(name(time_ns));
            // A finished file of the same name must not be overwritten either.
            if !path.exists() {
                let unfinished = unfinished(&path);
                match OpenOptions::new().write(true).create_new(true).mode(MODE).open(&unfinished) {
                    Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
                    Err(e) => return Err(e),
                    Ok(file) => {
                        // Without locks on this file system `in_use` is true for every unfinished file.
                        let _ = file.try_lock();
                        return Ok((file, unfinished));
                    }
                }
            }
            time_ns += 1_000_000;
        }
    }

    /// Free space for recordings in bytes. If the folder does not exist, that of its nearest existing parent.
    ///
    /// # Errors
    /// The system cannot determine the free space.
    pub fn free(&self) -> io::Result<u64> {
        let there = self.0.ancestors().find(|folder| folder.exists()).unwrap_or(Path::new("."));
        let room = statvfs(there)?;
        Ok(room.f_bavail.saturating_mul(room.f_frsize))
    }

    /// All recordings, sorted by name.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn list(&self) -> io::Result<Vec<Recording>> {
        let mut recordings = Vec::new();
        for entry in fs::read_dir(&self.0)? {
            let entry = entry?;
            let ours = entry.file_name().to_str().is_some_and(is_ours);
            // A file that was renamed after it was listed has no metadata under its old name.
            if let Some(found) = entry.metadata().ok().filter(|found| ours && found.is_file()) {
                recordings.push(Recording { path: entry.path(), bytes: found.len() });
            }
        }
        recordings.sort();
        Ok(recordings)
    }
}

/// The file name of a recording that begins at this time: `trifacet-20260102T030405.678Z.mcap`.
pub(super) fn name(time_ns: i64) -> String {
    let time = Timestamp::from_nanosecond(time_ns.into()).unwrap_or(Timestamp::UNIX_EPOCH);
    format!("trifacet-{}.mcap", time.strftime("%Y%m%dT%H%M%S.%3fZ"))
}

/// The path of the same recording before it is finished.
fn unfinished(path: &Path) -> PathBuf {
    let mut path = path.as_os_str().to_owned();
    path.push(".");
    path.push(UNFINISHED);
    path.into()
}

/// Whether this is the file name of a recording, finished or not.
fn is_ours(name: &str) -> bool {
    let pattern = b"trifacet-00000000T000000.000Z.mcap";
    let name = name.strip_suffix(UNFINISHED).and_then(|name| name.strip_suffix('.')).unwrap_or(name);
    name.len() == pattern.len()
        && name.bytes().zip(pattern).all(|(found, wanted)| match wanted {
            b'0' => found.is_ascii_digit(),
            wanted => found == *wanted,
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_contain_utc_and_are_recognised() {
        let name = name(1_767_323_045_678_900_000);
        assert_eq!(name, "trifacet-20260102T030405.678Z.mcap");
        assert!(is_ours(&name) && is_ours(&format!("{name}.part")));
        for other in ["notes.txt", "trifacet.mcap", "trifacet-20260102T030405.678Z.mcap.bak", ".part"] {
            assert!(!is_ours(other), "{other}");
        }
    }
}
