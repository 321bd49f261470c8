//! The thread that waits for the disk, so that no other thread has to.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;

/// A job for the disk thread.
enum Job {
    Sync(Arc<File>, PathBuf),
    Close(Arc<File>, PathBuf),
}

/// Why a job of the disk thread failed.
#[derive(Debug, thiserror::Error)]
pub enum DiskError {
    /// The data cannot be synchronized.
    #[error("cannot sync {} to disk: {source}", file.display())]
    Sync {
        /// Path of the file.
        file: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// The path does not lead to the file any more.
    #[error("{} is missing: the file or its folder was moved or deleted", file.display())]
    Missing {
        /// Path of the file.
        file: PathBuf,
    },
    /// The file cannot be renamed to its finished name.
    #[error("cannot finish {}: {source}", file.display())]
    Finish {
        /// Path of the file.
        file: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
}

/// Result of a job.
pub struct Done {
    /// Path of the file when the job was submitted.
    pub path: PathBuf,
    /// The job was to finish the file. Otherwise it was to synchronize it.
    pub close: bool,
    /// The path now and the size in bytes, or the reason for the failure.
    pub result: Result<(PathBuf, u64), DiskError>,
}

/// The disk thread and its queue.
pub struct Disk {
    jobs: Option<mpsc::Sender<Job>>,
    done: mpsc::Receiver<Done>,
    thread: Option<JoinHandle<()>>,
    /// A synchronization is in progress; files that are being finished.
    syncing: bool,
    closing: u32,
}

impl Disk {
    /// Starts the thread.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn start() -> io::Result<Self> {
        let (jobs, todo) = mpsc::channel();
        let (tell, done) = mpsc::channel();
        let work = move || {
            // A closed channel means that the results are not needed any more.
            let _ = todo.into_iter().try_for_each(|job| tell.send(work(job)));
        };
        let thread = std::thread::Builder::new().name("disk".into()).spawn(work)?;
        Ok(Self { jobs: Some(jobs), done, thread: Some(thread), syncing: false, closing: 0 })
    }

    /// The next result, if there is one.
    pub fn done(&mut self) -> Option<Done> {
        let done = self.done.try_recv().ok()?;
        if done.close {
            self.closing -= 1;
        } else {
            self.syncing = false;
        }
        Some(done)
    }

    /// Whether files are being finished.
    pub fn closing(&self) -> bool {
        self.closing > 0
    }

    /// Waits until all jobs are done. Later jobs are ignored.
    pub fn wait(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }

    /// Synchronizes a file to disk, and checks that it still has this path.
    pub fn sync(&mut self, file: &Arc<File>, path: &Path) {
        // One synchronization at a time: a second one would not be faster.
        if !std::mem::replace(&mut self.syncing, true) {
            self.give(Job::Sync(Arc::clone(file), path.to_owned()));
        }
    }

    /// Synchronizes a file to disk, and renames it to its finished name.
    pub fn close(&mut self, file: Arc<File>, path: PathBuf) {
        self.closing += 1;
        self.give(Job::Close(file, path));
    }

    fn give(&self, job: Job) {
        if let Some(jobs) = &self.jobs {
            // The thread runs as long as `jobs` exists.
            let _ = jobs.send(job);
        }
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        self.wait();
    }
}

fn work(job: Job) -> Done {
    let (path, close, result) = match job {
        Job::Sync(file, path) => {
            let result = sync(&file, &path).map(|bytes| (path.clone(), bytes));
            (path, false, result)
        }
        Job::Close(file, path) => {
            let result = close(&file, &path);
            (path, true, result)
        }
    };
    Done { path, close, result }
}

/// Synchronizes the data, and checks that `path` still leads to the file. Returns its size in bytes.
fn sync(file: &File, path: &Path) -> Result<u64, DiskError> {
    let failed = |source| DiskError::Sync { file: path.to_owned(), source };
    file.sync_data().map_err(failed)?;
    if !leads_to(path, file).map_err(failed)? {
        return Err(DiskError::Missing { file: path.to_owned() });
    }
    file.metadata().map(|it| it.len()).map_err(failed)
}

/// Synchronizes the data first, then gives the file the name that marks it as complete.
fn close(file: &File, path: &Path) -> Result<(PathBuf, u64), DiskError> {
    let bytes = sync(file, path)?;
    let finished = path.with_extension("");
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::rename(path, &finished)
        .and_then(|()| File::open(folder)?.sync_all())
        .map_err(|source| DiskError::Finish { file: path.to_owned(), source })?;
    Ok((finished, bytes))
}

/// Whether this path leads to this file.
///
/// # Errors
/// The system cannot read the metadata of the path or of the file.
pub fn leads_to(path: &Path, file: &File) -> io::Result<bool> {
    let there = match fs::metadata(path) {
        Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            return Ok(false);
        }
        there => there?,
    };
    let file = file.metadata()?;
    Ok((there.dev(), there.ino()) == (file.dev(), file.ino()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wait(disk: &mut Disk) -> Done {
        loop {
            match disk.done() {
                Some(done) => return done,
                None => std::thread::yield_now(),
            }
        }
    }

    #[test]
    fn a_late_disk_error_is_reported_with_the_file() {
        let mut disk = Disk::start().unwrap();
        // A device file cannot be synchronized.
        let path = Path::new("/dev/null");
        disk.sync(&Arc::new(File::open(path).unwrap()), path);
        let done = wait(&mut disk);
        let reason = done.result.unwrap_err().to_string();
        assert!(!done.close && done.path == path && reason.contains("cannot sync /dev/null"), "{reason}");
    }

    #[test]
    fn only_the_written_file_is_finished() {
        let folder = tempfile::tempdir().unwrap();
        let [path, away] = ["a.mcap.part", "away"].map(|name| folder.path().join(name));
        let mut disk = Disk::start().unwrap();
        let file = Arc::new(File::create(&path).unwrap());
        file.set_len(7).unwrap();
        fs::rename(&path, &away).unwrap();
        File::create(&path).unwrap(); // a different file of the same name
        disk.close(Arc::clone(&file), path.clone());
        assert!(disk.closing());
        let reason = wait(&mut disk).result.unwrap_err().to_string();
        assert!(!disk.closing() && path.exists() && reason.contains("is missing"), "{reason}");
        fs::rename(&away, &path).unwrap();
        disk.close(file, path.clone());
        assert_eq!(wait(&mut disk).result.unwrap(), (path.with_extension(""), 7));
        assert!(!path.exists());
    }
}
