//! Lines of a file that grows, of a pipe, or of standard input, read by a thread of their own.

use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

use tokio::sync::mpsc;

/// Interval of looking for more lines of a file.
const LOOK: Duration = Duration::from_millis(50);

/// A line with its number in the file, or the error that ended the reading.
pub(super) type Line = io::Result<(u64, String)>;

/// Lines of standard input. The thread is not joined at the end, because a read may block for ever.
pub(super) fn of_stdin() -> mpsc::UnboundedReceiver<Line> {
    reading(|sender| {
        let mut number = 0;
        forward(io::stdin().lock(), &mut number, sender)
    })
}

/// Lines of a pipe. When its writer closes it, it is opened again.
pub(super) fn of_pipe(path: &Path) -> mpsc::UnboundedReceiver<Line> {
    let path = path.to_owned();
    reading(move |sender| {
        let mut number = 0;
        while !sender.is_closed() {
            forward(BufReader::new(File::open(&path)?), &mut number, sender)?;
        }
        Ok(())
    })
}

/// Lines of a file, also those that are appended later.
pub(super) fn of_file(path: PathBuf) -> mpsc::UnboundedReceiver<Line> {
    reading(move |sender| {
        let mut file = BufReader::new(File::open(path)?);
        let (mut line, mut number) = (String::new(), 0);
        while !sender.is_closed() {
            file.read_line(&mut line)?;
            if line.ends_with('\n') {
                number += 1;
                let _ = sender.send(Ok((number, std::mem::take(&mut line)))); // the loop notices the end
            } else {
                sleep(LOOK); // the rest of the line may follow
            }
        }
        Ok(())
    })
}

fn reading(
    read: impl FnOnce(&mpsc::UnboundedSender<Line>) -> io::Result<()> + Send + 'static,
) -> mpsc::UnboundedReceiver<Line> {
    let (sender, lines) = mpsc::unbounded_channel();
    std::thread::spawn(move || {
        if let Err(e) = read(&sender) {
            let _ = sender.send(Err(e)); // nobody waits any more
        }
    });
    lines
}

fn forward(from: impl BufRead, number: &mut u64, sender: &mpsc::UnboundedSender<Line>) -> io::Result<()> {
    for line in from.lines() {
        *number += 1;
        if sender.send(Ok((*number, line?))).is_err() {
            break;
        }
    }
    Ok(())
}
