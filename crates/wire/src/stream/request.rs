//! Requests of TCP clients, one ASCII line each. Pure: text to commands, and back for clients.

use std::collections::BTreeSet;
use std::fmt;

use crate::layout::COLUMNS;

/// Largest length of a line in bytes, without its line end.
pub const MAX_LINE: usize = 256;
/// The largest divider.
pub const MAX_DIVIDER: u32 = 1_000_000;

const COMMANDS: &str = "stream, pose?, status?, descriptor?, help, bye";
const OPTIONS: &str = "format=, divider=, rate_hz=, fields=, held=, events=";
const HELP: &str = "stream [format=binary|json|csv] [divider=N | rate_hz=F] [fields=A,B,...] [held=on|off] [events=on|off]; \
    pose?; status?; descriptor?; help; bye";

/// A valid request.
#[derive(Clone, Debug, PartialEq)]
pub enum ClientCommand {
    /// Sends frames in this form from now on.
    Stream(StreamRequest),
    /// Sends the newest pose in one line.
    Pose,
    /// Sends the newest state in one line.
    Status,
    /// Sends the descriptor, in one line of JSON.
    Descriptor,
    /// Sends the list of requests.
    Help,
    /// Closes the connection.
    Bye,
}

/// The stream that a client requests.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StreamRequest {
    /// Format of the frames.
    pub format: Format,
    /// Fraction of the frames that are sent.
    pub pace: Pace,
    /// The columns of text, in this order; `None`: all of them.
    pub fields: Option<Vec<&'static str>>,
    /// Whether a frame without a valid pose carries the last valid one (`POSE_HELD`) instead of NaN.
    pub held: bool,
    /// Whether changes of the lock state are sent as messages beside the frames.
    pub events: bool,
}

/// Format of the frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// Messages with header and CRC.
    #[default]
    Binary,
    /// One JSON object per line.
    Json,
    /// Comma-separated values.
    Csv,
}

impl Format {
    /// Name of the format in a request.
    pub fn name(self) -> &'static str {
        match self {
            Self::Binary => "binary",
            Self::Json => "json",
            Self::Csv => "csv",
        }
    }
}

/// Fraction of the frames that are sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// Frames whose sequence number is divisible by this.
    Divider(u32),
    /// About this many frames per second, by the nearest divider.
    RateHz(f64),
}

impl Default for Pace {
    fn default() -> Self {
        Self::Divider(1)
    }
}

impl Pace {
    /// The divider for a stream of `frames_hz` frames per second.
    pub fn divider(self, frames_hz: f64) -> u32 {
        match self {
            Self::Divider(divider) => divider,
            Self::RateHz(wanted) => {
                let least = (frames_hz / wanted).floor().clamp(1.0, f64::from(MAX_DIVIDER - 1));
                let misses = |divider: f64| (frames_hz / divider - wanted).abs();
                let nearest = if misses(least + 1.0) < misses(least) { least + 1.0 } else { least };
                nearest as u32
            }
        }
    }
}

/// The reason why a line is not a valid request.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("error: {found}; allowed: {allowed}")]
pub struct CommandError {
    pub(super) found: String,
    pub(super) allowed: String,
}

pub(super) fn wrong<T>(found: impl Into<String>, allowed: impl Into<String>) -> Result<T, CommandError> {
    Err(CommandError { found: found.into(), allowed: allowed.into() })
}

/// Text from a client, made safe to send back: ASCII, and limited in length.
fn quoted(text: &[u8]) -> String {
    format!("\"{}\"", harmless(text))
}

/// The same without quotes.
pub(super) fn harmless(text: &[u8]) -> String {
    let some = &text[..text.len().min(40)];
    let more = if some.len() < text.len() { "..." } else { "" };
    format!("{}{more}", some.escape_ascii())
}

impl ClientCommand {
    /// Parses a line without its line end.
    ///
    /// # Errors
    /// The line is not ASCII, not a known request, or has invalid options.
    pub fn parse(line: &[u8]) -> Result<Self, CommandError> {
        let Ok(text) = std::str::from_utf8(line) else {
            return wrong(format!("{} is not ASCII", quoted(line)), COMMANDS);
        };
        let mut words = text.split_ascii_whitespace();
        let name = words.next().unwrap_or_default().to_ascii_lowercase();
        let command = match name.as_str() {
            "stream" => return StreamRequest::parse(words).map(Self::Stream),
            "pose?" => Self::Pose,
            "status?" => Self::Status,
            "descriptor?" => Self::Descriptor,
            "help" => Self::Help,
            "bye" => Self::Bye,
            _ => return wrong(format!("{} is not a command", quoted(line)), COMMANDS),
        };
        match words.next() {
            None => Ok(command),
            Some(word) => wrong(format!("unexpected {} after {name}", quoted(word.as_bytes())), "nothing"),
        }
    }

    /// The list of requests, in one line.
    pub fn help() -> &'static str {
        HELP
    }
}

impl StreamRequest {
    fn parse<'a>(options: impl Iterator<Item = &'a str>) -> Result<Self, CommandError> {
        let mut request = Self::default();
        let mut seen = BTreeSet::new();
        for option in options {
            let option_text = quoted(option.as_bytes());
            let Some((key, value)) = option.split_once('=') else {
                return wrong(format!("{option_text} is not an option of stream"), OPTIONS);
            };
            match key {
                "format" => request.format = format(&option_text, value)?,
                "divider" => request.pace = Pace::Divider(divider(&option_text, value)?),
                "rate_hz" => request.pace = Pace::RateHz(rate(&option_text, value)?),
                "fields" => request.fields = Some(fields(value)?),
                "held" => request.held = on_or_off(&option_text, value)?,
                "events" => request.events = on_or_off(&option_text, value)?,
                _ => return wrong(format!("{option_text} is not an option of stream"), OPTIONS),
            }
            if !seen.insert(key) {
                return wrong(format!("{key} is given twice"), "each option once");
            }
        }
        if seen.contains("divider") && seen.contains("rate_hz") {
            return wrong("both divider and rate_hz", "one of them");
        }
        if request.format == Format::Binary && request.fields.is_some() {
            return wrong("fields with format=binary", "fields with format=json or format=csv");
        }
        Ok(request)
    }
}

fn format(option_text: &str, value: &str) -> Result<Format, CommandError> {
    let formats = [Format::Binary, Format::Json, Format::Csv];
    match formats.into_iter().find(|f| f.name() == value) {
        Some(format) => Ok(format),
        None => wrong(option_text, "format=binary, format=json, format=csv"),
    }
}

pub(super) fn divider(option_text: &str, value: &str) -> Result<u32, CommandError> {
    match value.parse() {
        Ok(divider @ 1..=MAX_DIVIDER) => Ok(divider),
        _ => wrong(option_text, format!("a divider from 1 to {MAX_DIVIDER}")),
    }
}

fn rate(option_text: &str, value: &str) -> Result<f64, CommandError> {
    match value.parse() {
        Ok(rate) if (1e-3..=1e6).contains(&rate) => Ok(rate),
        _ => wrong(option_text, "a rate_hz from 0.001 to 1000000"),
    }
}

pub(super) fn on_or_off(option_text: &str, value: &str) -> Result<bool, CommandError> {
    match value {
        "on" => Ok(true),
        "off" => Ok(false),
        _ => wrong(option_text, "on, off"),
    }
}

fn fields(value: &str) -> Result<Vec<&'static str>, CommandError> {
    let mut names = Vec::new();
    for name in value.split(',') {
        match COLUMNS.into_iter().find(|known| *known == name) {
            Some(known) if names.contains(&known) => {
                return wrong(format!("{known} twice"), "each field once");
            }
            Some(known) => names.push(known),
            None => {
                return wrong(format!("{} is not a field", quoted(name.as_bytes())), COLUMNS.join(", "));
            }
        }
    }
    Ok(names)
}

/// The request as sent by a client, without the line end.
impl fmt::Display for StreamRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "stream format={}", self.format.name())?;
        match self.pace {
            Pace::Divider(divider) => write!(f, " divider={divider}")?,
            Pace::RateHz(rate) => write!(f, " rate_hz={rate}")?,
        }
        if let Some(fields) = &self.fields {
            write!(f, " fields={}", fields.join(","))?;
        }
        if self.held {
            f.write_str(" held=on")?;
        }
        if self.events { f.write_str(" events=on") } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn parse(line: &str) -> Result<ClientCommand, String> {
        ClientCommand::parse(line.as_bytes()).map_err(|e| e.to_string())
    }

    fn request(line: &str) -> StreamRequest {
        match parse(line) {
            Ok(ClientCommand::Stream(request)) => request,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn commands_are_case_insensitive() {
        assert_eq!(parse("pose?"), Ok(ClientCommand::Pose));
        assert_eq!(parse("  BYE "), Ok(ClientCommand::Bye));
        assert_eq!(parse("Stream"), Ok(ClientCommand::Stream(StreamRequest::default())));
        let all = request("stream format=csv rate_hz=12.5 fields=sequence,tx_m held=on events=on");
        assert_eq!(all.format, Format::Csv);
        assert_eq!(all.pace, Pace::RateHz(12.5));
        assert_eq!(all.fields, Some(vec!["sequence", "tx_m"]));
        assert!(all.held && all.events);
    }

    #[test]
    fn errors_state_the_allowed_values() {
        for (line, found, allowed) in [
            ("pose", "\"pose\" is not a command", "pose?"),
            ("pose? now", "\"now\" after pose?", "nothing"),
            ("stream fast", "\"fast\" is not an option", "divider="),
            ("stream format=xml", "format=xml", "format=json"),
            ("stream divider=0", "divider=0", "1 to 1000000"),
            ("stream divider=1000001", "divider=1000001", "1 to 1000000"),
            ("stream rate_hz=nan", "rate_hz=nan", "0.001"),
            ("stream rate_hz=-1", "rate_hz=-1", "0.001"),
            ("stream rate_hz=5 divider=5", "both", "one of them"),
            ("stream divider=1 divider=2", "twice", "once"),
            ("stream fields=tx_m", "format=binary", "format=json"),
            ("stream format=json fields=tx", "\"tx\" is not a field", "tx_m, ty_m"),
            ("stream format=json fields=tx_m,tx_m", "tx_m twice", "once"),
            ("stream held=yes", "held=yes", "on, off"),
            ("stream events=1", "events=1", "on, off"),
            ("GET / HTTP/1.1", "GET", "stream"),
            ("\u{7}\u{e9}", "\\x07\\xc3\\xa9", "stream"),
        ] {
            let error = parse(line).unwrap_err();
            assert!(error.starts_with("error: ") && error.is_ascii(), "{error}");
            assert!(error.contains(found) && error.contains(allowed), "{line}: {error}");
        }
    }

    #[test]
    fn the_nearest_divider_is_taken() {
        for (rate, divider) in [(1000.0, 1), (5000.0, 1), (100.0, 10), (300.0, 3), (400.0, 3), (0.5, 2000)] {
            assert_eq!(Pace::RateHz(rate).divider(1000.0), divider, "{rate}");
        }
        assert_eq!(Pace::RateHz(1e-3).divider(1e5), MAX_DIVIDER);
    }

    proptest! {
        #[test]
        fn any_line_gets_a_one_line_answer(line in prop::collection::vec(any::<u8>(), 0..=MAX_LINE)) {
            if let Err(error) = ClientCommand::parse(&line) {
                let text = error.to_string();
                prop_assert!(text.is_ascii() && !text.contains(['\n', '\r']), "{}", text);
            }
        }

        #[test]
        fn requests_survive_a_round_trip(
            format in prop::sample::select(vec![Format::Binary, Format::Json, Format::Csv]),
            pace in prop_oneof![(1..=MAX_DIVIDER).prop_map(Pace::Divider), (1e-3..1e6).prop_map(Pace::RateHz)],
            held: bool,
            events: bool,
            fields in prop::option::of(prop::sample::subsequence(COLUMNS.to_vec(), 1..8)),
        ) {
            let fields = fields.filter(|_| format != Format::Binary);
            let request = StreamRequest { format, pace, fields, held, events };
            prop_assert_eq!(ClientCommand::parse(request.to_string().as_bytes()), Ok(ClientCommand::Stream(request)));
        }
    }
}
