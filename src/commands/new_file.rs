//! A new file that appears under its name only when it is complete, and never replaces another file.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, ErrorKind, Write as _};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use anyhow::Context;
use rustix::fs::{AtFlags, CWD, Mode, OFlags, RenameFlags, linkat, open, renameat_with};
use rustix::io::Errno;
use trifacet::exit::{self, Failure};

/// A file while it is written. It has no name until it is complete, so nothing remains if the program ends
/// early.
#[derive(Debug)]
pub(crate) struct NewFile {
    path: PathBuf,
    file: File,
    /// Temporary name, on file systems that do not support unnamed files.
    part: Option<Part>,
}

#[derive(Debug)]
struct Part(PathBuf);

impl Drop for Part {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0); // fails if the file already has its final name
    }
}

impl NewFile {
    /// Starts a new file. `source`: the file whose permissions it gets, if there is one.
    pub(crate) fn create(path: &Path, source: Option<&Metadata>) -> anyhow::Result<Self> {
        if path.symlink_metadata().is_ok() {
            return Err(exists(path));
        }
        let mode = source.map_or(0o666, Metadata::mode) & 0o666;
        let (file, part) = unnamed(path, mode).with_context(|| cannot(path))?;
        Ok(Self { path: path.to_owned(), file, part })
    }

    /// Writes a whole new file.
    pub(crate) fn write(path: &Path, contents: &[u8]) -> anyhow::Result<()> {
        let file = Self::create(path, None)?;
        cannot_write(file.writer()?.write_all(contents), path)?;
        file.keep()
    }

    /// A handle for writing.
    pub(crate) fn writer(&self) -> anyhow::Result<File> {
        self.file.try_clone().with_context(|| cannot(&self.path))
    }

    /// Gives the complete file its name.
    pub(crate) fn keep(self) -> anyhow::Result<()> {
        self.file.sync_all().with_context(|| cannot(&self.path))?;
        let done = match &self.part {
            None => {
                let open = format!("/proc/self/fd/{}", self.file.as_raw_fd());
                linkat(CWD, open, CWD, &self.path, AtFlags::SYMLINK_FOLLOW)
            }
            Some(Part(part)) => match renameat_with(CWD, part, CWD, &self.path, RenameFlags::NOREPLACE) {
                Err(Errno::INVAL) => return fs::rename(part, &self.path).with_context(|| cannot(&self.path)),
                done => done,
            },
        };
        match done {
            Err(Errno::EXIST) => Err(exists(&self.path)),
            done => done.map_err(io::Error::from).with_context(|| cannot(&self.path)),
        }
    }
}

fn unnamed(path: &Path, mode: u32) -> io::Result<(File, Option<Part>)> {
    let folder = path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    let flags = OFlags::TMPFILE | OFlags::WRONLY | OFlags::CLOEXEC;
    match open(folder, flags, Mode::from_raw_mode(mode)) {
        Ok(file) => Ok((file.into(), None)),
        Err(Errno::OPNOTSUPP | Errno::ISDIR | Errno::INVAL) => {
            let name = path.file_name().ok_or(ErrorKind::InvalidInput)?.to_string_lossy();
            let part = folder.join(format!(".{name}.{}.part", std::process::id()));
            let file = OpenOptions::new().write(true).create_new(true).mode(mode).open(&part)?;
            Ok((file, Some(Part(part))))
        }
        Err(e) => Err(e.into()),
    }
}

fn exists(path: &Path) -> anyhow::Error {
    Failure::new(exit::IO, format!("{} exists already: choose another file", path.display())).into()
}

fn cannot(path: &Path) -> String {
    format!("cannot write {}", path.display())
}

/// Adds the path to an error of writing.
pub(crate) fn cannot_write<T, E>(result: Result<T, E>, path: &Path) -> anyhow::Result<T>
where
    Result<T, E>: Context<T, E>,
{
    result.with_context(|| cannot(path))
}
