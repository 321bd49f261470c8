//! Replaces the contents of a file, and keeps everything else: owner, group, permissions, access control list,
//! other attributes, and links.
//!
//! A new file that gets all of these takes the place of the old one; a crash leaves the old or the new contents.
//! If this is not possible, the old file is overwritten after a copy was made: the file has several names, is
//! mounted by itself, or its owner cannot be given to a new file.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Write as _};
use std::os::unix::fs::{FileExt as _, MetadataExt as _, OpenOptionsExt as _, fchown};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use rustix::fs::{
    AtFlags, CWD, StatxAttributes, StatxFlags, XattrFlags, fgetxattr, fgetxattr_query, flistxattr,
    flistxattr_query, fremovexattr, fsetxattr, statx,
};
use rustix::io::Errno;

use super::file::read_regular;

/// Checks whether [`replace`] could replace the contents of this file. Changes nothing.
///
/// # Errors
/// Fails if the file is not a regular file, if no file of its size can be written beside it, or if neither a
/// new file could take its place nor the file be overwritten.
pub(super) fn check(file: &Path) -> anyhow::Result<()> {
    let old = read_regular(file)?;
    let target = fs::canonicalize(file)?;
    let new = Beside::write(&target, "new", &old)?;
    if new.take_over(&target)? { Ok(()) } else { open(&target).map(drop) }
}

/// Replaces the contents of a file. Follows links to the file.
///
/// # Errors
/// Fails if the contents cannot be written. The old contents then remain; if they cannot be restored, the
/// message names the copy.
pub(super) fn replace(file: &Path, contents: &[u8]) -> anyhow::Result<()> {
    let target = fs::canonicalize(file)?;
    let new = Beside::write(&target, "new", contents)?;
    if new.take_over(&target)? {
        match fs::rename(&new.path, &target) {
            Ok(()) => return Ok(sync_folder(&target)?),
            // The file is mounted by itself.
            Err(e) if e.kind() == ErrorKind::ResourceBusy || e.kind() == ErrorKind::CrossesDevices => {}
            Err(e) => return Err(e.into()),
        }
    }
    overwrite(&target, contents)
}

/// Overwrites a file after a copy of it is on the disk.
fn overwrite(target: &Path, contents: &[u8]) -> anyhow::Result<()> {
    let old = read_regular(target)?;
    let file = open(target)?;
    let copy = Beside::write(target, "old", &old)?;
    sync_folder(target)?;
    let Err(error) = put(&file, contents) else { return Ok(()) };
    let Err(also) = put(&file, &old) else { return Err(error.into()) };
    let path = copy.keep();
    Err(error).with_context(|| {
        format!("the contents cannot be restored either ({also}); a copy of them is {}", path.display())
    })
}

fn put(file: &File, contents: &[u8]) -> io::Result<()> {
    file.write_all_at(contents, 0)?;
    file.set_len(contents.len() as u64)?;
    file.sync_all()
}

/// Opens a file for overwriting.
fn open(target: &Path) -> anyhow::Result<File> {
    OpenOptions::new()
        .write(true)
        .open(target)
        .context("its owner, group and permissions can be kept only by overwriting it, which is not possible")
}

fn sync_folder(target: &Path) -> io::Result<()> {
    File::open(target.parent().unwrap_or(Path::new("/")))?.sync_all()
}

/// A temporary file in the folder of another one. Removed when dropped.
#[derive(Debug)]
struct Beside {
    path: PathBuf,
    file: File,
}

impl Drop for Beside {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path); // fails if the file was renamed or is kept
    }
}

impl Beside {
    /// Writes a file that only its owner may read: the contents may include a token.
    fn write(target: &Path, extension: &str, contents: &[u8]) -> anyhow::Result<Self> {
        let name = target.file_name().unwrap_or_default().to_string_lossy();
        let path = target.with_file_name(format!(".{name}.{}.{extension}", std::process::id()));
        // Left by a process that was killed and had the same number. Others are not touched.
        let _ = fs::remove_file(&path);
        let made = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&path);
        let file = made.with_context(|| format!("cannot create {}", path.display()))?;
        let mut beside = Self { path, file };
        let written = beside.file.write_all(contents).and_then(|()| beside.file.sync_all());
        written.with_context(|| format!("cannot write {}", beside.path.display()))?;
        Ok(beside)
    }

    /// Gives the file all properties of another one. Returns false if it cannot take the place of that one.
    fn take_over(&self, target: &Path) -> io::Result<bool> {
        let old = File::open(target)?;
        Ok(old.metadata()?.nlink() == 1 && !is_mount(target) && self.dress(&old).is_ok())
    }

    fn dress(&self, old: &File) -> io::Result<()> {
        let [is, wanted] = [self.file.metadata()?, old.metadata()?];
        if (is.uid(), is.gid()) != (wanted.uid(), wanted.gid()) {
            fchown(&self.file, Some(wanted.uid()), Some(wanted.gid()))?;
        }
        self.file.set_permissions(wanted.permissions())?;
        let [is, wanted] = [attributes(&self.file)?, attributes(old)?];
        for name in is.keys().filter(|name| !wanted.contains_key(*name)) {
            fremovexattr(&self.file, name.as_slice())?;
        }
        for (name, value) in wanted.iter().filter(|(name, value)| is.get(*name) != Some(value)) {
            fsetxattr(&self.file, name.as_slice(), value, XattrFlags::empty())?;
        }
        Ok(())
    }

    /// Leaves the file in the folder.
    fn keep(mut self) -> PathBuf {
        std::mem::take(&mut self.path)
    }
}

/// Extended attributes, which include the access control list.
fn attributes(file: &File) -> io::Result<BTreeMap<Vec<u8>, Vec<u8>>> {
    let mut names = match flistxattr_query(file) {
        Err(Errno::NOTSUP) | Ok(0) => return Ok(BTreeMap::new()),
        size => vec![0; size?],
    };
    let size = flistxattr(file, &mut names[..])?;
    let names = names[..size].split(|byte| *byte == 0).filter(|name| !name.is_empty());
    let value = |name: &[u8]| {
        let mut value = vec![0; fgetxattr_query(file, name)?];
        if !value.is_empty() {
            let size = fgetxattr(file, name, &mut value[..])?;
            value.truncate(size);
        }
        Ok((name.to_owned(), value))
    };
    names.map(value).collect()
}

/// Whether a file is mounted by itself, as into a container. False if the system cannot tell.
fn is_mount(target: &Path) -> bool {
    statx(CWD, target, AtFlags::SYMLINK_NOFOLLOW, StatxFlags::BASIC_STATS)
        .is_ok_and(|found| found.stx_attributes.contains(StatxAttributes::MOUNT_ROOT))
}
