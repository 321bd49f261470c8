//! A file in the making.

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
    /// Entries behind that: lost if it ends here.
    torn: u64,
    /// There is a sample or a frame in it.
    any: bool,
    /// Configuration and source that were written last, without their stamps.
    standing: [Vec<u8>; 2],
    keyframes: u32,
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
            told: AtomicU64::new(0),
            whole,
            head: whole,
            torn: 0,
            any: false,
            standing: Default::default(),
            keyframes: 0,
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

    /// Takes a message; false if it says again what stands already, and not long before.
    ///
    /// # Errors
    /// It cannot be written.
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
            // Behind the encapsulation and the stamp.
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

    /// Hands over to the system what there is.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.writer.flush()?;
        (self.whole, self.torn) = (self.bytes(), 0);
        Ok(())
    }

    /// Entries that are lost if it ends here.
    pub fn torn(&self) -> u64 {
        self.torn
    }

    /// Asks for it to be on the disk.
    pub fn sync(&self, disk: &mut Disk) {
        disk.sync(&self.file, &self.path);
    }

    /// Writes the index, and gives the file its name as soon as it is on the disk. False if there is nothing
    /// in it: then it is not kept.
    ///
    /// # Errors
    /// It cannot be written.
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

    /// Leaves it unfinished, cut to what is whole; gives where it is, if it is there and anything is in it.
    pub fn abandon(self) -> Option<PathBuf> {
        let Self { writer, file, path, whole, head, failed, .. } = self;
        failed.store(true, Ordering::Relaxed);
        drop(writer); // it would finish the file
        if whole > head {
            cut(&file, whole);
            Some(path).filter(|path| leads_to(path, &file).is_ok_and(|it_does| it_does))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_keyframes_rest_on_stands_in_it_again_now_and_then() {
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
