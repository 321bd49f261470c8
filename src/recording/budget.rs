//! Keeps the recordings of a folder within a budget.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use trifacet_core::time::NS_PER_S;

use super::folder::{Folder, Recording, name};

/// A name is in the future if it is this much later than the clock. A clock that is corrected by less, as by a
/// time server, does not change the order of deletion.
const FUTURE_NS: i64 = 60 * NS_PER_S;

/// The order of deletion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Age {
    /// The name is in the future: a wrong clock gave it before this process began.
    Future,
    /// An earlier process recorded it at the time in its name.
    Earlier,
    /// This process recorded it, as its file of this number. Its order does not depend on the clock.
    Own(u64),
}

/// Deletes the oldest recordings of a folder.
#[derive(Debug)]
pub struct Budget {
    /// Space for all recordings, bytes.
    bytes: u64,
    /// Paths of the files of this process as finished files, with their number.
    own: HashMap<PathBuf, u64>,
    /// Number of files that this process has begun.
    begun: u64,
}

impl Budget {
    /// A budget of this number of bytes.
    pub fn new(bytes: u64) -> Self {
        Self { bytes, own: HashMap::new(), begun: 0 }
    }

    /// Notes that this process has begun a file. It is newer than all others.
    pub fn began(&mut self, unfinished: &Path) {
        self.begun += 1;
        self.own.insert(unfinished.with_extension(""), self.begun);
    }

    /// Deletes the oldest recordings until `wanted` bytes are left within the budget. `now_ns` is the present
    /// time, UTC. Files in use are kept. Returns the deleted recordings.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn make_room(&mut self, folder: &Folder, wanted: u64, now_ns: i64) -> io::Result<Vec<Recording>> {
        let mut all = folder.list()?;
        let there: HashSet<PathBuf> = all.iter().map(Recording::finished).collect();
        self.own.retain(|own, _| there.contains(own));
        all.sort_by_cached_key(|recording| (self.age(recording, now_ns), recording.path.clone()));
        let mut taken: u64 = all.iter().map(|r| r.bytes).sum();
        let mut deleted = Vec::new();
        for recording in all {
            if taken + wanted <= self.bytes {
                break;
            }
            if recording.in_use() {
                continue;
            }
            match fs::remove_file(&recording.path) {
                Ok(()) => {
                    taken -= recording.bytes;
                    deleted.push(recording);
                }
                // It has been renamed or deleted since it was listed.
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(e) => tracing::warn!(
                    file = %recording.path.display(),
                    "cannot delete an old recording to stay within recording.budget_gb: {e}"
                ),
            }
        }
        Ok(deleted)
    }

    fn age(&self, recording: &Recording, now_ns: i64) -> Age {
        match self.own.get(&recording.finished()) {
            Some(number) => Age::Own(*number),
            None if in_future(recording, now_ns) => Age::Future,
            None => Age::Earlier,
        }
    }
}

/// Whether the name of a recording is later than the present time, UTC.
pub fn in_future(recording: &Recording, now_ns: i64) -> bool {
    // Names have a fixed width, so that they compare as their times.
    recording.finished().file_name().is_some_and(|found| *found > *name(now_ns + FUTURE_NS))
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY_NS: i64 = 86_400 * NS_PER_S;

    /// Creates a finished recording of 100 bytes that begins at this time.
    fn record(folder: &Folder, time_ns: i64) -> PathBuf {
        let (file, path) = folder.create(time_ns).unwrap();
        file.set_len(100).unwrap();
        let finished = path.with_extension("");
        fs::rename(path, &finished).unwrap();
        finished
    }

    #[test]
    fn names_from_the_future_are_deleted_first_and_own_files_last_in_their_order() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder(dir.path().to_owned());
        let now_ns = 20_000 * DAY_NS;
        let mut budget = Budget::new(700);
        let mut expected = Vec::new();
        // A later daemon sees names of 2031 and of half a minute ahead, and then its clock goes back.
        for time_ns in [now_ns + 10 * DAY_NS, now_ns + 20 * DAY_NS, now_ns - DAY_NS, now_ns + DAY_NS / 2880] {
            expected.push(record(&folder, time_ns));
        }
        for time_ns in [now_ns, now_ns - 2 * DAY_NS, now_ns - DAY_NS / 2] {
            let own = record(&folder, time_ns);
            budget.began(&own.with_added_extension("part"));
            expected.push(own);
        }
        assert!(budget.make_room(&folder, 0, now_ns).unwrap().is_empty());
        for path in expected {
            let deleted = budget.make_room(&folder, 100, now_ns).unwrap();
            assert_eq!(deleted.iter().map(|old| &old.path).collect::<Vec<_>>(), [&path]);
            budget.bytes -= 100;
        }
    }

    #[test]
    fn only_the_oldest_own_recordings_are_deleted() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder(dir.path().to_owned());
        let foreign = dir.path().join("aaa.mcap");
        fs::write(&foreign, [0; 1000]).unwrap();
        let mut budget = Budget::new(350);
        let mut make_room = || budget.make_room(&folder, 100, DAY_NS).unwrap();
        let mut open = Vec::new();
        for second in 0..5 {
            let (file, path) = folder.create(second * NS_PER_S).unwrap();
            file.set_len(100).unwrap();
            assert!(path.to_str().unwrap().ends_with(".mcap.part"));
            open.push(file);
        }
        let (_open, other) = folder.create(0).unwrap();
        assert!(other.to_str().unwrap().contains("000000.001Z"), "no file is overwritten");
        assert!(make_room().is_empty(), "all are being written");
        open.drain(1..);
        let deleted = make_room();
        assert_eq!(deleted.len(), 3, "{deleted:?}");
        let left: Vec<String> = folder.list().unwrap().iter().map(|r| r.path.display().to_string()).collect();
        let names = ["000000.000Z", "000000.001Z", "000004.000Z"];
        assert!(
            left.len() == 3 && left.iter().zip(names).all(|(path, name)| path.contains(name)),
            "{left:?}"
        );
        assert!(foreign.exists());
    }
}
