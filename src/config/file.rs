//! Reads the files of a configuration: the TOML file itself and its correction tables.

use std::fs::{File, FileType, OpenOptions};
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;

/// Largest file in bytes. A larger one is not a configuration or a table, and could use up the memory.
const LARGEST: u64 = 64 << 20;

/// Reads a file of any kind. A pipe is read to its end.
///
/// # Errors
/// Fails if the file cannot be opened or read, or is too large.
pub(super) fn read_any(path: &Path) -> io::Result<Vec<u8>> {
    contents(&File::open(path)?)
}

/// Reads a regular file. The contents of anything else can be read only once, or never end; even opening it
/// can block.
///
/// # Errors
/// Fails if the path does not lead to a regular file, or if the file cannot be opened or read, or is too large.
pub(super) fn read_regular(path: &Path) -> io::Result<Vec<u8>> {
    // Without O_NONBLOCK, opening a FIFO waits for a writer.
    let flags = OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = OpenOptions::new().read(true).custom_flags(flags.bits() as i32).open(path)?;
    let kind = file.metadata()?.file_type();
    if !kind.is_file() {
        return Err(io::Error::new(
            ErrorKind::InvalidInput,
            format!("it is {}, not a regular file", name(kind)),
        ));
    }
    contents(&file)
}

fn contents(file: &File) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(LARGEST + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > LARGEST {
        return Err(io::Error::other(format!("it has more than {} MiB", LARGEST >> 20)));
    }
    Ok(bytes)
}

fn name(kind: FileType) -> &'static str {
    if kind.is_fifo() {
        "a pipe"
    } else if kind.is_dir() {
        "a folder"
    } else if kind.is_socket() {
        "a socket"
    } else {
        "a device"
    }
}
