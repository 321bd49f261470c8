//! Loads a file and checks it.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::check::{Checker, Finding, Report, without_index};
use super::error::{ConfigError, InvalidValues, Problem};
use super::file::{read_any, read_regular};
use super::locate::{Found, find, path_at, place, remove_at};
use super::{Config, Fault, FaultKind, Token};
use crate::text::decode;

/// Most unknown keys and wrong types that are reported at once.
const MOST_OF_SHAPE: usize = 20;

/// Reads and checks a configuration file, which may be a pipe. `None`: returns the defaults. Blocks.
///
/// # Errors
/// Fails if the file cannot be read, or if it is not a valid configuration.
pub fn load(file: Option<&Path>) -> Result<Config, ConfigError> {
    let Some(file) = file else { return parse("", None) };
    let bytes = read_any(file).map_err(|reason| unreadable(file, reason))?;
    parse(text(&bytes, file)?, Some(file))
}

/// Reads and checks the configuration file of a running daemon again. Blocks.
///
/// # Errors
/// Fails as [`load()`], and if the file is not a regular file or is empty. A pipe has no contents any more. An
/// empty file is left by a full disk or a power failure; it would set every key to its default.
pub fn load_again(file: &Path) -> Result<Config, ConfigError> {
    let bytes = read_regular(file).map_err(|reason| match reason.kind() {
        ErrorKind::InvalidInput => {
            let why = format!("{reason}, so it cannot be read again; restart the daemon with the new file");
            unreadable(file, io::Error::new(ErrorKind::InvalidInput, why))
        }
        _ => unreadable(file, reason),
    })?;
    let text = text(&bytes, file)?;
    if text.trim().is_empty() {
        let message = "the file is empty, which would set every key to its default; allowed is a file with \
                       at least one line";
        return Err(wrong(file, Problem { place: None, message: message.into() }));
    }
    parse(text, Some(file))
}

/// The text of a configuration file.
///
/// # Errors
/// Fails with the place of the first byte that is not text in UTF-8.
pub(super) fn text<'b>(bytes: &'b [u8], file: &Path) -> Result<&'b str, ConfigError> {
    decode(bytes).map_err(|e| wrong(file, Problem { place: Some(e.place), message: e.to_string() }))
}

fn unreadable(file: &Path, reason: io::Error) -> ConfigError {
    ConfigError::Unreadable { file: file.to_owned(), reason }
}

fn wrong(file: &Path, problem: Problem) -> ConfigError {
    ConfigError::Wrong { file: Some(file.to_owned()), problems: vec![problem] }
}

/// Parses and checks the text of a configuration. `file`: its name in messages; paths are relative to it.
/// Without a file, correction tables and calibration record are not read.
///
/// # Errors
/// Fails with all problems if the text is not a valid configuration.
pub fn parse(text: &str, file: Option<&Path>) -> Result<Config, ConfigError> {
    read(text, file).map_err(|problems| ConfigError::Wrong { file: file.map(PathBuf::from), problems })
}

fn read(text: &str, file: Option<&Path>) -> Result<Config, Vec<Problem>> {
    let table = DeTable::parse(text).map_err(|e| vec![syntax_problem(text, &e)])?;
    let located = DeValue::Table(table.get_ref().clone());
    let (config, mut problems) = deserialize(text, &located, table);
    let Some(mut config) = config else { return Err(problems) };
    if let Ok(taken) = toml::Value::try_from(&config) {
        find_surplus(&located, &taken, "", text, &mut problems);
    }
    let incomplete = !problems.is_empty();
    let mut report = Report { incomplete, ..Report::default() };
    match file {
        Some(file) if !has_folder(file) => demand_absolute_paths(&config, &mut Checker::root(&mut report)),
        file => resolve_paths(&mut config, file),
    }
    let placed = report.findings.is_empty();
    config.check(&mut Checker::root(&mut report));
    if file.is_some() && placed {
        config.channels.check_tables(Checker::root(&mut report).section("channels"));
        config.calibration.check_record(Checker::root(&mut report).section("calibration"));
    }
    if incomplete {
        report.findings.retain(|finding| is_independent(&located, finding));
    }
    if problems.is_empty() && report.findings.is_empty() {
        return Ok(config);
    }
    problems.extend(report.findings.iter().map(|f| value_problem(text, &located, f)));
    problems.sort_by_key(|p| p.place.map_or((usize::MAX, 0), |place| (place.line, place.column)));
    Err(problems)
}

/// The configuration without the entries that have unknown keys or values of the wrong type, and the problems
/// of these entries. `None` if it cannot be read even without them.
fn deserialize(
    text: &str,
    located: &DeValue<'_>,
    mut table: Spanned<DeTable<'_>>,
) -> (Option<Config>, Vec<Problem>) {
    let mut problems = Vec::new();
    loop {
        let error = match Config::deserialize(toml::Deserializer::from(table.clone())) {
            Ok(config) => return (Some(config), problems),
            Err(error) => error,
        };
        problems.push(shape_problem(text, located, &error));
        let removed = error.span().is_some_and(|span| remove_at(table.get_mut(), span.start));
        if !removed || problems.len() == MOST_OF_SHAPE {
            return (None, problems);
        }
    }
}

/// Whether a finding concerns only one key, and this key is in the file. Other findings may come from a default
/// in place of an entry that could not be read.
fn is_independent(located: &DeValue<'_>, finding: &Finding) -> bool {
    finding.keys.len() == 1 && matches!(find(located, &finding.keys[0]), Found::Value(_))
}

impl Config {
    /// Checks a configuration that was not parsed from a file. Reads no correction tables and no calibration record.
    ///
    /// # Errors
    /// Fails with all problems: keys, values, and what is allowed.
    pub fn verify(&self) -> Result<(), InvalidValues> {
        let mut report = Report::default();
        self.check(&mut Checker::root(&mut report));
        if report.findings.is_empty() { Ok(()) } else { Err(InvalidValues(report.findings)) }
    }
}

/// Finds arrays with more numbers than were parsed: serde ignores the rest silently.
fn find_surplus(file: &DeValue<'_>, taken: &toml::Value, path: &str, text: &str, to: &mut Vec<Problem>) {
    let DeValue::Table(table) = file else { return };
    for (name, value) in table {
        let Some(taken) = taken.get(name.get_ref().as_ref()) else { continue };
        let dot = if path.is_empty() { "" } else { "." };
        let key = format!("{path}{dot}{}", name.get_ref());
        match (value.get_ref(), taken) {
            (DeValue::Array(written), toml::Value::Array(taken)) if written.len() > taken.len() => {
                let (found, allowed) = (written.len(), taken.len());
                let message = format!("{key} has {found} values: allowed are {allowed}");
                to.push(Problem { place: Some(place(text, value.span().start)), message });
            }
            (file, taken) => find_surplus(file, taken, &key, text, to),
        }
    }
}

/// Whether paths can be relative to the folder of the configuration: not if it comes from a pipe, or from another
/// open file of the process, whose name is that of a descriptor.
fn has_folder(file: &Path) -> bool {
    let descriptor = ["/dev/fd", "/dev/stdin", "/proc"].iter().any(|place| file.starts_with(place));
    !descriptor && file.metadata().map_or(true, |about| about.is_file())
}

fn demand_absolute_paths(config: &Config, at: &mut Checker<'_>) {
    let channels = ["channels.a", "channels.b", "channels.c"].into_iter().zip(config.channels.psds());
    let tables = channels.map(|(section, psd)| (section, "correction", psd.correction.as_deref()));
    let others = [
        ("calibration", "record", config.calibration.record.as_deref()),
        ("recording", "folder", Some(&*config.recording.folder)),
        ("replay", "file", Some(&*config.replay.file)),
    ];
    for (section, key, path) in tables.chain(others) {
        let relative = path.filter(|path| path.is_relative() && !path.as_os_str().is_empty());
        let found = relative.unwrap_or(Path::new("")).display();
        let allowed = "an absolute path, because the configuration comes from a pipe, which has no folder";
        at.section(section).demand(relative.is_none(), key, found, allowed);
    }
}

fn resolve_paths(config: &mut Config, file: Option<&Path>) {
    let folder = file.and_then(Path::parent).unwrap_or(Path::new(""));
    for psd in config.channels.psds_mut() {
        psd.correction = psd.correction.take().map(|table| folder.join(table));
    }
    config.calibration.record = config.calibration.record.take().map(|record| folder.join(record));
    let recordings = &mut config.recording.folder;
    if !recordings.as_os_str().is_empty() {
        *recordings = folder.join(&*recordings);
    }
    if config.replay.file.is_relative() && !config.replay.file.as_os_str().is_empty() {
        config.replay.file = folder.join(&config.replay.file);
    }
}

/// The problem of a text that is not TOML.
fn syntax_problem(text: &str, error: &toml::de::Error) -> Problem {
    let place = error.span().map(|span| place(text, span.start));
    Problem { place, message: format!("not TOML: {}", error.message()) }
}

/// The problem of a text that is TOML, but has an unknown key or a value of the wrong type.
fn shape_problem(text: &str, file: &DeValue<'_>, error: &toml::de::Error) -> Problem {
    let span = error.span();
    let key = span.as_ref().and_then(|span| path_at(file, span.start)).unwrap_or_default();
    let serde_says = error.message();
    let message = if let Some(rest) = serde_says.strip_prefix("unknown field ") {
        unknown_key(&key, rest)
    } else {
        let value = span.clone().and_then(|span| one_line(text.get(span)?));
        let shown = |v: &String| !v.starts_with('[') && key != Token::KEY;
        let found = value.filter(shown).map_or(String::new(), |v| format!(" = {v}"));
        let allowed = allowed_at(&key).map_or(String::new(), |rule| format!("; allowed is {rule}"));
        format!("{key}{found}: {serde_says}{allowed}")
    };
    Problem { place: span.map(|span| place(text, span.start)), message }
}

/// The problem of a value that is not allowed.
fn value_problem(text: &str, file: &DeValue<'_>, finding: &Finding) -> Problem {
    let Finding { keys, found, allowed } = finding;
    let key = &keys[0];
    let at = |at: usize| Some(place(text, at));
    match find(file, key) {
        Found::Value(span) => {
            let written = text.get(span.clone()).filter(|_| key != Token::KEY).and_then(one_line);
            let written = written.unwrap_or_else(|| found.clone());
            Problem { place: at(span.start), message: format!("{key} = {written}: allowed is {allowed}") }
        }
        Found::Section { span, whole: true } => Problem {
            place: span.and_then(|s| at(s.start)),
            message: format!("{key}: {found}; allowed is {allowed}"),
        },
        // The key is not in the file: its default conflicts with another key, or a required key is absent.
        Found::Section { span, whole: false } => {
            let clash = keys[1..].iter().find_map(|other| match find(file, other) {
                Found::Value(span) => Some(span),
                Found::Section { .. } => None,
            });
            let note = if found == "absent" { "" } else { " (default)" };
            let message = format!("{key} = {found}{note}: allowed is {allowed}");
            Problem { place: clash.or(span).and_then(|s| at(s.start)), message }
        }
    }
}

/// `rest`: serde's message after "unknown field": the name found, and the known names, in backticks.
fn unknown_key(key: &str, rest: &str) -> String {
    let mut names = rest.split('`').skip(1).step_by(2);
    let name = names.next().unwrap_or_default();
    let known: Vec<_> = names.collect();
    let nearest = known
        .iter()
        .map(|candidate| (strsim::jaro_winkler(name, candidate), candidate))
        .filter(|(likeness, _)| *likeness > 0.8)
        .max_by(|a, b| a.0.total_cmp(&b.0));
    let hint = nearest.map_or(String::new(), |(_, candidate)| format!(" (did you mean {candidate}?)"));
    format!("{key} is not a key of this section{hint}; allowed are {}", known.join(", "))
}

fn one_line(text: &str) -> Option<String> {
    (!text.contains('\n') && text.chars().count() <= 60).then(|| text.to_owned())
}

/// What the checks allow for a key. Needed if the type is wrong, because no check then saw the value.
fn allowed_at(key: &str) -> Option<String> {
    let mut config = Config::default();
    let kinds = [
        FaultKind::PsdDark { psd: 0 },
        FaultKind::Clipped { channel: 0 },
        FaultKind::Dropped { fraction: 0.0 },
        FaultKind::LaserPower { factor: 1.0 },
        FaultKind::Bursts { interval_ms: 100.0 },
        FaultKind::Flicker { fraction: 0.0, frequency_hz: 0.0 },
    ];
    config.twin.fault = kinds.map(|kind| Fault { at_s: 0.0, for_s: None, kind }).to_vec();
    let mut report = Report::default();
    config.check(&mut Checker::root(&mut report));
    report.rules.remove(&without_index(key))
}
