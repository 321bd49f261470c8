//! A recording that is being written.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use trifacet_core::time::Mono;

use super::Topic;
use super::codec::{AGAIN, Encoded};
use super::disk::{Disk, leads_to};
use super::folder::Folder;
use super::writer::{RecordError, Writer};

/// A recording that is being written.
pub struct Output {
    writer: Writer<Tail>,
    file: Arc<File>,
    /// Its path until it is finished.
    pub path: PathBuf,
    /// Start of the recording, monotonic.
    pub since: Mono,
    written: Arc<AtomicU64>,
    failed: Arc<AtomicBool>,
    reported: AtomicU64,
    /// Bytes up to the last complete chunk, and bytes before the first message.
    whole: u64,
    head: u64,
    /// Entries after the last complete chunk: lost if the file ends here.
    torn: u64,
    /// The file contains a sample or a frame.
    any: bool,
    /// Last written configuration and source, without their stamps.
    standing: [Vec<u8>; 2],
    keyframes: u32,
}

/// Writes to the file. After an error it writes nothing: data after an incomplete chunk could not be found.
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
                Err(explained(e))
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

/// Adds the remedy to the error of a file that has reached its largest size.
fn explained(error: io::Error) -> io::Error {
    if error.kind() != io::ErrorKind::FileTooLarge {
        return error;
    }
    let remedy = "reduce recording.rotate_mb, or raise the limit of the process (RLIMIT_FSIZE, LimitFSIZE=)";
    io::Error::new(error.kind(), format!("{error}; {remedy}"))
}

impl Output {
    /// Begins a file.
    ///
    /// `time_ns` is its start in UTC, `since` the current monotonic time.
    ///
    /// # Errors
    /// The file cannot be created or its header cannot be written.
    pub fn begin(
        folder: &Folder,
        time_ns: i64,
        since: Mono,
        compression: Option<mcap::Compression>,
    ) -> Result<Self, RecordError> {
        let (file, path) = folder.create(time_ns)?;
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
            reported: AtomicU64::new(0),
            whole,
            head: whole,
            torn: 0,
            any: false,
            standing: Default::default(),
            keyframes: 0,
        })
    }

    /// Bytes written since the last call.
    pub fn news(&self) -> u64 {
        let bytes = self.bytes();
        bytes - self.reported.swap(bytes, Ordering::Relaxed)
    }

    /// Bytes written so far.
    pub fn bytes(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// Writes a message. Returns false if it repeats a recent configuration or source, which is not written.
    ///
    /// # Errors
    /// The message cannot be written.
    pub fn put(&mut self, message: Encoded<'_>) -> Result<bool, RecordError> {
        self.any |= matches!(message.topic, Topic::Sample | Topic::Frame);
        self.torn +=
            u64::from(!matches!(message.topic, Topic::Pose | Topic::Config | Topic::Source | Topic::Gap));
        let standing = match message.topic {
            Topic::Config => Some(&mut self.standing[0]),
            Topic::Source => Some(&mut self.standing[1]),
            _ => None,
        };
        if let Some(standing) = standing {
            // Skip the encapsulation and the stamp.
            let text = message.data.get(12..).unwrap_or_default();
            if standing == text {
                return Ok(false);
            }
            text.clone_into(standing);
        }
        self.writer.put(message)?;
        self.keyframes += u32::from(message.topic == Topic::Keyframe);
        if self.keyframes == AGAIN {
            (self.standing, self.keyframes) = Default::default();
        }
        Ok(true)
    }

    /// Ends the chunk and writes it to the file.
    ///
    /// # Errors
    /// The chunk cannot be written.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.writer.flush()?;
        (self.whole, self.torn) = (self.bytes(), 0);
        Ok(())
    }

    /// Entries that would be lost if the file ended here.
    pub fn torn(&self) -> u64 {
        self.torn
    }

    /// Has the file synchronized to disk by the disk thread.
    pub fn sync(&self, disk: &mut Disk) {
        disk.sync(&self.file, &self.path);
    }

    /// Writes the index. The disk thread then renames the file once it is on disk. Returns false if the file
    /// contains no sample and no frame: it is removed.
    ///
    /// # Errors
    /// The index cannot be written.
    pub fn finish(self, disk: &mut Disk) -> Result<bool, RecordError> {
        let Self { writer, file, path, whole, any, .. } = self;
        if let Err(e) = writer.finish() {
            cut(&file, whole);
            return Err(e.into());
        }
        if any {
            disk.close(file, path);
        } else {
            remove(&path);
        }
        Ok(any)
    }

    /// Leaves the file unfinished, cut after the last complete chunk. Returns its path, if the file
    /// is still there and contains data.
    pub fn abandon(self) -> Option<PathBuf> {
        let Self { writer, file, path, whole, head, failed, .. } = self;
        failed.store(true, Ordering::Relaxed);
        drop(writer); // dropping it would finish the file; `failed` keeps it from writing
        if whole > head {
            cut(&file, whole);
            Some(path).filter(|path| leads_to(path, &file).is_ok_and(|it_does| it_does))
        } else {
            remove(&path);
            None
        }
    }
}

/// Cuts off an incomplete chunk. If that fails, a reader detects the incomplete end.
fn cut(file: &File, whole: u64) {
    let _ = file.set_len(whole);
}

fn remove(path: &Path) {
    // The file contains no data: if it cannot be removed, it does no harm.
    let _ = fs::remove_file(path);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_that_keyframes_depend_on_are_repeated_periodically() {
        let dir = tempfile::tempdir().unwrap();
        let mut output = Output::begin(&Folder(dir.path().to_owned()), 0, Mono(0), None).unwrap();
        let mut put = |topic| output.put(Encoded { topic, time_ns: 0, data: &[0; 20] }).unwrap();
        for _ in 0..3 {
            assert!(put(Topic::Config) && !put(Topic::Config));
            for _ in 0..AGAIN {
                assert!(put(Topic::Keyframe));
            }
        }
    }
}
