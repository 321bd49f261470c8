//! The thread that waits for the disk, so that nothing else has to.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;

/// What is to be done on the disk.
enum Job {
    Sync(Arc<File>, PathBuf),
    Close(Arc<File>, PathBuf),
}

/// What came of it.
pub struct Done {
    /// The file, by the name that it had when this was asked.
    pub path: PathBuf,
    /// It was to be finished. Else it was brought to the disk, and goes on.
    pub close: bool,
    /// Its name now and its size in bytes, or what is wrong.
    pub result: Result<(PathBuf, u64), String>,
}

/// The thread.
pub struct Disk {
    jobs: Option<mpsc::Sender<Job>>,
    done: mpsc::Receiver<Done>,
    thread: Option<JoinHandle<()>>,
    /// Whether a file is being brought to the disk, and how many are being finished.
    syncing: bool,
    closing: u32,
}

impl Disk {
    /// Starts it.
    ///
    /// # Errors
    /// No thread can be had.
    pub fn start() -> io::Result<Self> {
        let (jobs, todo) = mpsc::channel();
        let (tell, done) = mpsc::channel();
        let work = move || {
            // Who does not listen any more does not need it.
            let _ = todo.into_iter().try_for_each(|job| tell.send(work(job)));
        };
        let thread = std::thread::Builder::new().name("disk".into()).spawn(work)?;
        Ok(Self { jobs: Some(jobs), done, thread: Some(thread), syncing: false, closing: 0 })
    }

    /// What came of a job since the last time.
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

    /// Waits for all that is still to be done; nothing can be asked of it after that.
    pub fn wait(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }

    /// Brings a file to the disk, and looks whether it is still where it should be.
    pub fn sync(&mut self, file: &Arc<File>, path: &Path) {
        // One that has not yet come back will not be made faster by another.
        if !std::mem::replace(&mut self.syncing, true) {
            self.give(Job::Sync(Arc::clone(file), path.to_owned()));
        }
    }

    /// Brings a file to the disk, and gives it the name of one that is finished.
    pub fn close(&mut self, file: Arc<File>, path: PathBuf) {
        self.closing += 1;
        self.give(Job::Close(file, path));
    }

    fn give(&self, job: Job) {
        if let Some(jobs) = &self.jobs {
            // It lives as long as this.
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

/// The data on the disk, in the file that people will find; gives its size.
fn sync(file: &File, path: &Path) -> Result<u64, String> {
    let failed = |e: io::Error| format!("cannot bring {} to the disk: {e}", path.display());
    file.sync_data().map_err(failed)?;
    if !leads_to(path, file).map_err(failed)? {
        return Err(format!("{} is gone: it, or its folder, was moved or deleted", path.display()));
    }
    file.metadata().map(|it| it.len()).map_err(failed)
}

/// First the data, then the name that says they are all there.
fn close(file: &File, path: &Path) -> Result<(PathBuf, u64), String> {
    let bytes = sync(file, path)?;
    let finished = path.with_extension("");
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::rename(path, &finished)
        .and_then(|()| File::open(folder)?.sync_all())
        .map_err(|e| format!("cannot finish {}: {e}", path.display()))?;
    Ok((finished, bytes))
}

/// Whether this path leads to this very file.
///
/// # Errors
/// The system does not say.
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
    fn a_disk_that_fails_late_is_told_with_the_file() {
        let mut disk = Disk::start().unwrap();
        // What has no disk behind it cannot be brought there.
        let path = Path::new("/dev/null");
        disk.sync(&Arc::new(File::open(path).unwrap()), path);
        let done = wait(&mut disk);
        let reason = done.result.unwrap_err();
        assert!(!done.close && done.path == path && reason.contains("cannot bring /dev/null"), "{reason}");
    }

    #[test]
    fn only_the_very_file_that_was_written_is_finished() {
        let folder = tempfile::tempdir().unwrap();
        let [path, away] = ["a.mcap.part", "away"].map(|name| folder.path().join(name));
        let mut disk = Disk::start().unwrap();
        let file = Arc::new(File::create(&path).unwrap());
        file.set_len(7).unwrap();
        fs::rename(&path, &away).unwrap();
        File::create(&path).unwrap(); // somebody else's, of the same name
        disk.close(Arc::clone(&file), path.clone());
        assert!(disk.closing());
        let reason = wait(&mut disk).result.unwrap_err();
        assert!(!disk.closing() && path.exists() && reason.contains("is gone"), "{reason}");
        fs::rename(&away, &path).unwrap();
        disk.close(file, path.clone());
        assert_eq!(wait(&mut disk).result.unwrap(), (path.with_extension(""), 7));
        assert!(!path.exists());
    }
}
