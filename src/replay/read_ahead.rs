//! Files, read in a thread of their own: one core unpacks and decodes while the other solves.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use crate::recording::reader::{Read, ReadError, Reader, Tally};

/// Batches that may wait.
const AHEAD: usize = 64;
/// Things in a batch: few enough to stay in the cache, and below the size for which memory is mapped anew.
const BATCH: usize = 128;

/// What comes from the files.
#[derive(Debug)]
pub enum News {
    /// What was read next, and how many bytes of all files were read.
    Read(Vec<Read>, u64),
    /// A file is at its end; what was in it.
    End(PathBuf, Box<Tally>),
    /// A file cannot be read; nothing comes after this.
    Failed(ReadError),
}

/// The news of these files, one file after the other.
pub fn read(files: Vec<PathBuf>) -> Receiver<News> {
    let (to, news) = sync_channel(AHEAD);
    thread::spawn(move || {
        let mut before = 0;
        for file in files {
            match one(&file, before, &to) {
                Ok(Some(tally)) => {
                    before += tally.size;
                    if to.send(News::End(file, Box::new(tally))).is_err() {
                        return;
                    }
                }
                Ok(None) => return, // nobody listens any more
                Err(error) => return drop(to.send(News::Failed(error))),
            }
        }
    });
    news
}

fn one(file: &std::path::Path, before: u64, to: &SyncSender<News>) -> Result<Option<Tally>, ReadError> {
    let mut reader = Reader::open(file, Reader::REPLAY)?;
    let mut batch = Vec::with_capacity(BATCH);
    while let Some(read) = reader.read()? {
        batch.push(read);
        if batch.len() == BATCH {
            let full = std::mem::replace(&mut batch, Vec::with_capacity(BATCH));
            if to.send(News::Read(full, before + reader.at())).is_err() {
                return Ok(None);
            }
        }
    }
    let sent = to.send(News::Read(batch, before + reader.at()));
    Ok(sent.is_ok().then(|| reader.tally().clone()))
}
