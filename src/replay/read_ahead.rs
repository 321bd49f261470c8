//! Reads files in a thread, so that one core decompresses and decodes while another one solves.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use crate::recording::reader::{Read, ReadError, Reader, Tally};

/// Batches that can wait.
const AHEAD: usize = 64;
/// Items in a batch: few enough for the cache, and below the size from which memory is mapped anew.
const BATCH: usize = 128;

/// A message from the reading thread.
#[derive(Debug)]
pub enum News {
    /// The next items, and the bytes read from all files so far.
    Read(Vec<Read>, u64),
    /// The end of a file, with counts of its contents.
    End(PathBuf, Box<Tally>),
    /// A file cannot be read. This is the last message.
    Failed(ReadError),
}

/// Reads these files one after the other.
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
                Ok(None) => return, // the receiver is closed
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
