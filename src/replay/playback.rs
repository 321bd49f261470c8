//! The items of a file that is read ahead, repeated if wanted. Nothing here waits.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, TryRecvError};

use super::read_ahead::{self, News};
use crate::recording::reader::Read;

/// The recording that a daemon replays.
#[derive(Debug)]
pub struct Playback {
    file: PathBuf,
    /// `None` after the end.
    news: Option<Receiver<News>>,
    ready: std::vec::IntoIter<Read>,
}

/// The next step of a playback.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "reads are the rule")]
pub enum Next {
    /// The next item.
    Read(Read),
    /// The next item has not been read yet.
    Later,
    /// The end of the file. Returned once.
    End,
    /// There is nothing more.
    Nothing,
}

impl Playback {
    /// Starts at the beginning of this file.
    pub fn new(file: PathBuf) -> Self {
        Self { news: Some(read_ahead::read(vec![file.clone()])), file, ready: Vec::new().into_iter() }
    }

    /// Returns to the beginning.
    pub fn again(&mut self) {
        *self = Self::new(std::mem::take(&mut self.file));
    }

    /// Whether the playback has ended.
    pub fn over(&self) -> bool {
        self.news.is_none()
    }

    /// The next step. If the file cannot be read, this is logged and the playback ends.
    pub fn take(&mut self) -> Next {
        loop {
            if let Some(read) = self.ready.next() {
                return Next::Read(read);
            }
            let Some(news) = &self.news else { return Next::Nothing };
            match news.try_recv() {
                Ok(News::Read(reads, _)) => self.ready = reads.into_iter(),
                Ok(News::End(..)) => {}
                Ok(News::Failed(error)) => {
                    tracing::error!(%error, "cannot read the recording");
                    self.news = None;
                }
                Err(TryRecvError::Empty) => return Next::Later,
                Err(TryRecvError::Disconnected) => {
                    self.news = None;
                    return Next::End;
                }
            }
        }
    }
}
