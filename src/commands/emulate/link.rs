//! A symbolic link to a port, removed together with the port.

use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::{fs, io};

use trifacet::exit::{Failure, IO};

/// A link that is removed when it is dropped.
#[derive(Debug)]
pub(super) struct Link {
    path: PathBuf,
    target: PathBuf,
}

impl Link {
    /// Creates `path` as a link to `target`. An existing link is replaced; any other file is left
    /// unchanged.
    pub(super) fn new(path: &Path, target: &Path) -> Result<Self, Failure> {
        let failed = |error: io::Error| Failure::new(IO, format!("{}: {error}", path.display()));
        match fs::symlink_metadata(path) {
            Ok(there) if !there.is_symlink() => {
                let reason = "exists and is not a symbolic link; it is not replaced";
                return Err(Failure::new(IO, format!("{}: {reason}", path.display())));
            }
            Ok(_) => fs::remove_file(path).map_err(failed)?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(failed(error)),
        }
        symlink(target, path).map_err(failed)?;
        Ok(Self { path: path.to_owned(), target: target.to_owned() })
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        // Another process may have replaced the link in the meantime.
        if fs::read_link(&self.path).is_ok_and(|target| target == self.target) {
            let _ = fs::remove_file(&self.path); // a dangling link would be replaced the next time
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_replaces_only_a_link_and_is_removed_with_its_port() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("board");
        let old = Link::new(&path, Path::new("/dev/pts/old")).unwrap();
        let new = Link::new(&path, Path::new("/dev/pts/new")).unwrap();
        drop(old);
        assert_eq!(fs::read_link(&path).unwrap(), Path::new("/dev/pts/new"));
        drop(new);
        assert!(fs::symlink_metadata(&path).is_err());
        fs::write(&path, "data").unwrap();
        let refused = Link::new(&path, Path::new("/dev/pts/new")).unwrap_err();
        assert!(refused.message.contains("board: exists"), "{refused}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "data");
    }
}
