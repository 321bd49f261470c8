//! The reasons why data cannot be recorded.

use std::io;
use std::path::PathBuf;

use crate::recording::disk::DiskError;
use crate::recording::writer::RecordError;

/// Why data cannot be recorded.
#[derive(Debug, thiserror::Error)]
pub(super) enum FaultReason {
    /// The folder cannot be used.
    #[error("cannot record in recording.folder, {}: {source}", folder.display())]
    Folder { folder: PathBuf, source: io::Error },
    /// The files in the folder cannot be listed.
    #[error("cannot list files in recording.folder, {}: {source}", folder.display())]
    List { folder: PathBuf, source: io::Error },
    /// Too few bytes are free on the file system.
    #[error("not enough space: {free} bytes are free in recording.folder, {}; free some space", folder.display())]
    NoSpace { folder: PathBuf, free: u64 },
    /// A file cannot be begun.
    #[error("cannot create a file in recording.folder, {}: {source}", folder.display())]
    Create { folder: PathBuf, source: RecordError },
    /// Messages cannot be written.
    #[error("cannot write to recording.folder, {}: {source}", folder.display())]
    Write { folder: PathBuf, source: RecordError },
    /// The index of a file cannot be written.
    #[error("cannot finish {} (restore it with trifacet recover): {source}", file.display())]
    Finish { file: PathBuf, source: RecordError },
    /// The disk thread has failed.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// The queue of the recorder is full.
    #[error("the recorder has fallen behind: is the disk too slow?")]
    Behind,
}
