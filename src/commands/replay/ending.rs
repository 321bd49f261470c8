//! Reports at the end of a replay.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use trifacet::exit::{self, Failure};
use trifacet::publishing::columns::{Value, rfc3339};
use trifacet::recording::reader::Tally;
use trifacet::replay::comparison::Difference;
use trifacet::replay::{Comparison, Engine};

/// A file and the summary of its contents.
type Read = (PathBuf, Box<Tally>);

/// Prints irregularities of the files.
pub(super) fn print_irregularities(files: &[Read]) {
    for (file, tally) in files {
        let file = file.display();
        for odd in tally.without_config().into_iter().chain(tally.unfinished()) {
            eprintln!("trifacet: {file}: {odd}");
        }
    }
    for odd in files.windows(2).filter_map(|pair| seam(&pair[0], &pair[1])) {
        eprintln!("trifacet: {odd}");
    }
}

/// Irregularity between two consecutive files.
fn seam((a, before): &Read, (b, after): &Read) -> Option<String> {
    let [a, b] = [a, b].map(|file: &PathBuf| Path::display(file));
    let (before_session, after_session) = (before.sessions.last(), after.sessions.first());
    if before_session.zip(after_session).is_some_and(|(before, after)| before != after) {
        return Some(format!("{b} was recorded in another run of the daemon than {a}"));
    }
    let ([_, last], [first, _]) = before.samples.zip(after.samples)?;
    if first <= last {
        return Some(format!(
            "{b} begins with sample {first}, but {a} before it ends with sample {last}: give each file once, in order"
        ));
    }
    let missing = first - last - 1;
    (missing > 0).then(|| format!("between {a} and {b} {} missing", are(missing, "sample")))
}

/// Why no frame was computed.
pub(super) fn nothing(files: &[Read]) -> Failure {
    let none = |of: fn(&Tally) -> bool| files.iter().all(|(_, tally)| of(tally));
    let why = if none(|tally| tally.time_ns.is_none()) {
        "it contains no trifacet data: is this a recording of trifacet?"
    } else if none(|tally| tally.configs.is_empty()) && files.iter().any(|(_, tally)| tally.incomplete()) {
        "the readable parts do not contain the configuration"
    } else if none(|tally| tally.configs.is_empty()) {
        "it contains no configuration"
    } else if none(|tally| tally.sessions.is_empty()) {
        "it contains no frames to compare with"
    } else {
        "it contains no frame after a keyframe and its sample"
    };
    Failure::new(exit::DATA, format!("no frame can be computed again: {why}"))
}

/// The result as text.
pub(super) fn text(comparison: &Comparison, engine: &Engine) -> String {
    let Comparison { same, renamed, untested, other, unrecorded, unrepeated, .. } = comparison;
    let all = same + renamed + untested + other;
    let mut text = format!("{same} of {all} frames are identical, bit by bit\n");
    let mut say = |line: String| {
        let _ = writeln!(text, "{line}"); // writing to a String cannot fail
    };
    if *renamed > 0 {
        say(format!(
            "{} only in the name of a status bit: recorded by a version without POWER_NOISY, which set \
             PSD_A_LOW, PSD_B_LOW or PSD_C_LOW instead",
            count(*renamed, "frame") + if *renamed == 1 { " differs" } else { " differ" }
        ));
    }
    if *untested > 0 {
        say(format!(
            "{} only in INCONSISTENT or OUT_OF_CALIBRATION: recorded by a version that did not test this",
            count(*untested, "frame") + if *untested == 1 { " differs" } else { " differ" }
        ));
    }
    if *unrecorded > 0 {
        say(format!("{} without a recorded frame", count(*unrecorded, "report")));
    }
    if *unrepeated > 0 {
        say(format!("{} not computed: the required data were not recorded", are(*unrepeated, "frame")));
    }
    say(format!("the state was initialised from {} and then computed", count(engine.taken_up, "keyframe")));
    text
}

/// The failure for a frame that differs.
pub(super) fn different(difference: &Difference) -> Failure {
    let Difference { time_ns, index, column, then, now } = difference;
    let by = match (then, now) {
        (Value::Number(then), Value::Number(now)) => format!(", by {:e}", now - then),
        _ => String::new(),
    };
    let what = format!(
        "the first difference is at {}, sample {index}: {column} was {}, now it is {}{by}",
        rfc3339(*time_ns),
        then.csv(),
        now.csv()
    );
    Failure::new(exit::DIFFERENT, what)
}

/// Fails if data are missing or frames could not be compared.
pub(super) fn holes(files: &[Read], passed_over: u64) -> Result<(), Failure> {
    let sum = |of: fn(&Tally) -> usize| files.iter().map(|(_, tally)| of(tally) as u64).sum::<u64>();
    let (damages, gaps) = (sum(|tally| tally.damages.len()), sum(|tally| tally.gaps.len()));
    let at_end: u64 = files.iter().map(|(_, tally)| tally.lost_at_end()).sum();
    let why = match (damages, gaps, passed_over) {
        (0, 0, 0) if at_end == 0 => return Ok(()),
        (0, 0, 0) => {
            format!("the recording is not complete: {at_end} bytes at its end are an incomplete chunk")
        }
        (0, 0, frames) => format!("{} not compared", are(frames, "frame")),
        (0, gaps, _) => format!("the recording is not complete: it has {}", count(gaps, "gap")),
        (places, ..) => format!("not everything was compared: {} cannot be read", count(places, "place")),
    };
    Err(Failure::new(exit::DATA, why))
}

fn count(n: u64, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

fn are(n: u64, what: &str) -> String {
    format!("{} {}", count(n, what), if n == 1 { "is" } else { "are" })
}
