//! Reads the files of a configuration: the TOML file itself, its correction tables and its calibration record.

use std::fs::{File, FileType, OpenOptions};
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;

/// Largest configuration or table in bytes. A larger file is neither, and could use up the memory.
const LARGEST: u64 = 64 << 20;

/// Reads a file of any kind. A pipe is read to its end.
///
/// # Errors
/// Fails if the file cannot be opened or read, or is too large.
pub(super) fn read_any(path: &Path) -> io::Result<Vec<u8>> {
    contents(&File::open(path)?, LARGEST)
}

/// Reads a regular file. The contents of anything else can be read only once, or never end; even opening it
/// can block.
///
/// # Errors
/// Fails if the path does not lead to a regular file, or if the file cannot be opened or read, or is too large.
pub(super) fn read_regular(path: &Path) -> io::Result<Vec<u8>> {
    read_regular_up_to(path, LARGEST)
}

/// As [`read_regular`], for files of at most `largest` bytes.
///
/// # Errors
/// As [`read_regular`].
pub(super) fn read_regular_up_to(path: &Path, largest: u64) -> io::Result<Vec<u8>> {
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
    contents(&file, largest)
}

fn contents(file: &File, largest: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(largest + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > largest {
        return Err(io::Error::other(format!("it has more than {} MiB", largest >> 20)));
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
