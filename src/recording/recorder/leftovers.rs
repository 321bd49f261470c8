//! Unfinished recordings of earlier runs.

use std::fs;

use crate::recording::Reader;
use crate::recording::folder::Recording;

/// A recorder that is killed in its first half second leaves a file without data, which is smaller than this,
/// bytes. Larger files are not examined at the start.
const SMALL: u64 = 1 << 20;

/// What can be done with an unfinished recording.
enum Contents {
    /// It has data that can be restored.
    Data,
    /// It never had data.
    None,
    /// Its data cannot be read.
    Unreadable,
}

/// Reports an unfinished recording, and what to do with it. One without data is deleted, as at the end of a
/// recording.
pub(super) fn report(left: &Recording) {
    let file = left.path.display();
    match contents(left) {
        Contents::Data => {
            tracing::warn!(%file, "found an unfinished recording; restore it with trifacet recover FILE");
        }
        Contents::Unreadable => {
            tracing::warn!(%file, "found an unfinished recording of which nothing can be read; delete it");
        }
        Contents::None => match fs::remove_file(&left.path) {
            Ok(()) => tracing::info!(%file, "deleted an unfinished recording without data"),
            Err(e) => tracing::warn!(%file, "cannot delete an unfinished recording without data: {e}"),
        },
    }
}

fn contents(left: &Recording) -> Contents {
    if left.bytes == 0 {
        return Contents::None;
    }
    if left.bytes > SMALL {
        return Contents::Data;
    }
    let Ok(mut reader) = Reader::open(&left.path, &[]) else { return Contents::Unreadable };
    while let Ok(true) = reader.raw(|_, _, _| {}) {}
    let tally = reader.tally();
    match tally.time_ns {
        Some(_) => Contents::Data,
        None if tally.torn == 0 && tally.strange == 0 && tally.damages.is_empty() => Contents::None,
        None => Contents::Unreadable,
    }
}
