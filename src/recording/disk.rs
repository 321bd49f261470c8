//! A file on the disk, and the thread that waits for the disk.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread::JoinHandle;

use super::Topic;
use super::codec::Encoded;
use super::folder::{Folder, UNFINISHED};
use super::writer::{RecordError, Writer};
use crate::clock::Mono;

/// A recording in the making.
pub struct Output {
    writer: Writer<Tail>,
    file: Arc<File>,
    /// Where it stands until it is finished.
    pub path: PathBuf,
    /// When it began.
    pub since: Mono,
    written: Arc<AtomicU64>,
    failed: Arc<AtomicBool>,
    told: AtomicU64,
    /// Bytes of it that make whole chunks, and those before the first message.
    whole: u64,
    head: u64,
    /// Configuration and source that were written last, without their stamps.
    standing: [Vec<u8>; 2],
}

/// Where the bytes go. After an error, nowhere: what follows a torn chunk would hide it.
struct Tail {
    file: Arc<File>,
    written: Arc<AtomicU64>,
    failed: Arc<AtomicBool>,
}

impl Write for Tail {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.failed.load(Ordering::Relaxed) {
            return Err(io::Error::other("the recording has failed"));
        }
        match (&*self.file).write(bytes) {
            Err(e) if e.kind() != io::ErrorKind::Interrupted => {
                self.failed.store(true, Ordering::Relaxed);
                Err(e)
            }
            done => {
                self.written.fetch_add(*done.as_ref().unwrap_or(&0) as u64, Ordering::Relaxed);
                done
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Output {
    /// Begins a file at this moment, UTC.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn begin(
        folder: &Folder,
        time_ns: i64,
        since: Mono,
        compression: Option<mcap::Compression>,
    ) -> Result<Self, RecordError> {
        let (file, path) = folder.create(time_ns).map_err(mcap::McapError::from)?;
        let file = Arc::new(file);
        let (written, failed) = (Arc::default(), Arc::default());
        let tail =
            Tail { file: Arc::clone(&file), written: Arc::clone(&written), failed: Arc::clone(&failed) };
        let begun = Writer::new(tail, compression).and_then(|mut writer| writer.flush().map(|()| writer));
        let writer = begun.inspect_err(|_| remove(&path))?;
        let whole = written.load(Ordering::Relaxed);
        Ok(Self {
            writer,
            file,
            path,
            since,
            written,
            failed,
            told: AtomicU64::new(0),
            whole,
            head: whole,
            standing: Default::default(),
        })
    }

    /// Bytes since this was last asked.
    pub fn news(&self) -> u64 {
        let bytes = self.bytes();
        bytes - self.told.swap(bytes, Ordering::Relaxed)
    }

    /// Bytes so far.
    pub fn bytes(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// Takes a message; false if it says again what stands already.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn put(&mut self, message: Encoded<'_>) -> Result<bool, RecordError> {
        let standing = match message.topic {
            Topic::Config => Some(&mut self.standing[0]),
            Topic::Source => Some(&mut self.standing[1]),
            _ => None,
        };
        if let Some(standing) = standing {
            // Behind the encapsulation and the stamp.
            let text = message.data.get(12..).unwrap_or_default();
            if standing == text {
                return Ok(false);
            }
            text.clone_into(standing);
        }
        self.writer.put(message)?;
        Ok(true)
    }

    /// Hands over to the system what there is.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.writer.flush()?;
        self.whole = self.bytes();
        Ok(())
    }

    /// Asks for it to be on the disk.
    pub fn sync(&self, disk: &Disk) {
        disk.sync(&self.file);
    }

    /// Writes the index, and gives the file its name as soon as it is on the disk.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(self, disk: &Disk) -> Result<(), RecordError> {
        let Self { writer, file, path, whole, .. } = self;
        if let Err(e) = writer.finish() {
            cut(&file, whole);
            return Err(e.into());
        }
        disk.close(file, path);
        Ok(())
    }

    /// Leaves it unfinished, cut to what is whole; gives where it is, if there is anything in it.
    pub fn abandon(self) -> Option<PathBuf> {
        let Self { writer, file, path, whole, head, failed, .. } = self;
        failed.store(true, Ordering::Relaxed);
        drop(writer); // it would finish the file
        if whole > head {
            cut(&file, whole);
            Some(path)
        } else {
            remove(&path);
            None
        }
    }
}

/// Cuts off what is torn. Where that is not possible either, whoever reads it finds it torn.
fn cut(file: &File, whole: u64) {
    let _ = file.set_len(whole);
}

fn remove(path: &Path) {
    // It has nothing in it; if it cannot be removed, it does no harm.
    let _ = fs::remove_file(path);
}

/// What is to be done on the disk.
enum Job {
    Sync(Arc<File>),
    Close(Arc<File>, PathBuf),
}

/// The thread that waits for the disk, so that nothing else has to.
pub struct Disk {
    jobs: Option<mpsc::Sender<Job>>,
    thread: Option<JoinHandle<()>>,
    busy: Arc<AtomicBool>,
    error: Arc<Mutex<Option<String>>>,
}

impl Disk {
    /// Starts it.
    ///
    /// # Errors
    /// No thread can be had.
    pub fn start() -> io::Result<Self> {
        let (jobs, todo) = mpsc::channel();
        let (busy, error) = <(Arc<AtomicBool>, Arc<Mutex<Option<String>>>)>::default();
        let (idle, failed) = (Arc::clone(&busy), Arc::clone(&error));
        let work = move || {
            for job in todo {
                let (what, done) = match job {
                    Job::Sync(file) => {
                        let done = file.sync_data();
                        idle.store(false, Ordering::Release);
                        ("cannot bring the recording to the disk", done)
                    }
                    Job::Close(file, path) => ("cannot finish the recording", close(&file, &path)),
                };
                if let Err(e) = done {
                    *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(format!("{what}: {e}"));
                }
            }
        };
        let thread = std::thread::Builder::new().name("disk".into()).spawn(work)?;
        Ok(Self { jobs: Some(jobs), thread: Some(thread), busy, error })
    }

    /// What went wrong since the last time.
    pub fn error(&self) -> Option<String> {
        self.error.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn sync(&self, file: &Arc<File>) {
        // One that has not yet come back will not be made faster by another.
        if !self.busy.swap(true, Ordering::Acquire) {
            self.give(Job::Sync(Arc::clone(file)));
        }
    }

    fn close(&self, file: Arc<File>, path: PathBuf) {
        self.give(Job::Close(file, path));
    }

    fn give(&self, job: Job) {
        if let Some(jobs) = &self.jobs {
            // It lives as long as this.
            let _ = jobs.send(job);
        }
    }
}

/// Waits for what is still to be done.
impl Drop for Disk {
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// First the data, then the name that says they are all there.
fn close(file: &File, path: &Path) -> io::Result<()> {
    file.sync_all()?;
    if path.extension().is_some_and(|extension| extension == UNFINISHED) {
        fs::rename(path, path.with_extension(""))?;
    }
    File::open(path.parent().unwrap_or(Path::new(".")))?.sync_all()
}
