//! A file that is read ahead, piece by piece, and as often as it is wanted. Nothing here waits.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, TryRecvError};

use super::read_ahead::{self, News};
use crate::recording::reader::Read;

/// The recording that a daemon replays.
#[derive(Debug)]
pub struct Playback {
    file: PathBuf,
    /// None behind the end.
    news: Option<Receiver<News>>,
    ready: std::vec::IntoIter<Read>,
}

/// What comes next.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "reads are the rule")]
pub enum Next {
    /// This.
    Read(Read),
    /// It is not read yet.
    Later,
    /// That was the last; said once.
    End,
    /// Nothing any more.
    Nothing,
}

impl Playback {
    /// At the beginning of this file.
    pub fn new(file: PathBuf) -> Self {
        Self { news: Some(read_ahead::read(vec![file.clone()])), file, ready: Vec::new().into_iter() }
    }

    /// Back to the beginning.
    pub fn again(&mut self) {
        *self = Self::new(std::mem::take(&mut self.file));
    }

    /// Whether nothing comes any more.
    pub fn over(&self) -> bool {
        self.news.is_none()
    }

    /// What comes next. A file that cannot be read any more gives nothing, which is logged.
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
                    tracing::error!(%error, "the recording cannot be read");
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
