//! The two text formats of `/metrics`, and the choice between them by `Accept`. Pure.

use std::fmt::Write as _;

use axum::http::{HeaderMap, header};

/// Quality values are in thousandths, the resolution of HTTP.
const FULL_QUALITY: u16 = 1000;

/// A format of the metrics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exposition {
    /// OpenMetrics 1.0.0.
    OpenMetrics,
    /// The text format 0.0.4 of Prometheus.
    Text,
}

impl Exposition {
    /// Value of the header `Content-Type`.
    pub fn content_type(self) -> &'static str {
        match self {
            Self::OpenMetrics => "application/openmetrics-text; version=1.0.0; charset=utf-8",
            Self::Text => "text/plain; version=0.0.4; charset=utf-8",
        }
    }

    /// Media type, subtype and version.
    fn media_type(self) -> [&'static str; 3] {
        match self {
            Self::OpenMetrics => ["application", "openmetrics-text", "1.0.0"],
            Self::Text => ["text", "plain", "0.0.4"],
        }
    }

    /// The format that the client prefers (RFC 9110, `Accept`). [`Exposition::Text`] if the client prefers
    /// neither, as other exporters do.
    pub fn preferred(headers: &HeaderMap) -> Self {
        let values = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
        let ranges: Vec<_> = values.flat_map(|value| value.split(',')).filter_map(Range::parse).collect();
        // The most specific range decides.
        let quality = |format| {
            let fits = ranges.iter().filter_map(|range| Some((range.specificity(format)?, range.quality)));
            fits.max().map_or(0, |(_, quality)| quality)
        };
        if quality(Self::OpenMetrics) > quality(Self::Text) { Self::OpenMetrics } else { Self::Text }
    }

    /// A page of OpenMetrics in this format.
    pub fn of(self, page: String) -> String {
        match self {
            Self::OpenMetrics => page,
            Self::Text => text(&page),
        }
    }
}

/// One media range of `Accept`.
struct Range<'a> {
    media_type: &'a str,
    subtype: &'a str,
    version: Option<&'a str>,
    quality: u16,
}

impl<'a> Range<'a> {
    /// Parses a range; `None` if it is malformed. Parameters other than the version do not distinguish the
    /// formats.
    fn parse(text: &'a str) -> Option<Self> {
        let mut parts = text.split(';').map(str::trim);
        let (media_type, subtype) = parts.next()?.split_once('/')?;
        let mut range = Self { media_type, subtype, version: None, quality: FULL_QUALITY };
        for (name, value) in parts.filter_map(|part| part.split_once('=')) {
            let value = value.trim().trim_matches('"');
            match name.trim() {
                name if name.eq_ignore_ascii_case("q") => range.quality = thousandths(value)?,
                name if name.eq_ignore_ascii_case("version") => range.version = Some(value),
                _ => {}
            }
        }
        Some(range)
    }

    /// How closely the range describes this format; `None` if it does not contain it.
    fn specificity(&self, format: Exposition) -> Option<u8> {
        let [media_type, subtype, version] = format.media_type();
        match (self.media_type, self.subtype) {
            ("*", "*") => Some(0),
            (own, _) if !own.eq_ignore_ascii_case(media_type) => None,
            (_, "*") => Some(1),
            (_, own) if !own.eq_ignore_ascii_case(subtype) => None,
            _ => match self.version {
                None => Some(2),
                Some(own) => (own == version).then_some(3),
            },
        }
    }
}

fn thousandths(quality: &str) -> Option<u16> {
    let quality: f32 = quality.parse().ok()?;
    (0.0..=1.0).contains(&quality).then(|| (quality * f32::from(FULL_QUALITY)).round() as u16)
}

/// The text format of a page of OpenMetrics. The samples are the same. The comments differ: the text format
/// names counters and infos with their suffixes, has no type `info`, and no mark at the end.
fn text(page: &str) -> String {
    let mut text = String::with_capacity(page.len());
    let mut help = "";
    for line in page.lines().filter(|line| *line != "# EOF") {
        if let Some((_, meaning)) = family(line, "# HELP ") {
            help = meaning;
        } else if let Some((name, kind)) = family(line, "# TYPE ") {
            let (suffix, kind) = match kind {
                "counter" => ("_total", kind),
                "info" => ("_info", "gauge"),
                _ => ("", kind),
            };
            // Writing to a String cannot fail.
            let _ = writeln!(text, "# HELP {name}{suffix} {help}\n# TYPE {name}{suffix} {kind}");
        } else {
            let _ = writeln!(text, "{line}");
        }
    }
    text
}

/// Name and contents of a comment of this kind.
fn family<'a>(line: &'a str, kind: &str) -> Option<(&'a str, &'a str)> {
    line.strip_prefix(kind)?.split_once(' ')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn preferred(accept: &[&str]) -> Exposition {
        let headers = accept.iter().map(|value| (header::ACCEPT, value.parse().unwrap())).collect();
        Exposition::preferred(&headers)
    }

    #[test]
    fn the_format_with_the_larger_quality_is_sent() {
        let prometheus = "application/openmetrics-text;version=1.0.0;q=0.5,application/openmetrics-text;\
            version=0.0.1;q=0.4,text/plain;version=0.0.4;q=0.3,*/*;q=0.2";
        for open in [
            &[prometheus][..],
            &["application/openmetrics-text"],
            &["APPLICATION/OpenMetrics-Text; Version=\"1.0.0\"; charset=utf-8"],
            &["text/plain;q=0.3, application/openmetrics-text;q=0.31"],
            &["text/plain;q=0.3", "application/openmetrics-text"],
            &["text/*;q=0.1, */*"],
            &["text/plain;q=0, */*;q=0.1"],
            &["*/*;q=0.9, text/plain;q=0.5"],
        ] {
            assert_eq!(preferred(open), Exposition::OpenMetrics, "{open:?}");
        }
        for text in [
            &[][..],
            &["*/*"],
            &["text/plain"],
            &["text/plain;version=0.0.4"],
            &["text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"],
            &["application/openmetrics-text;q=0.3, text/plain;q=0.4"],
            &["application/openmetrics-text;version=0.0.1, text/plain;q=0.1"],
            &["application/openmetrics-text;q=0, */*;q=0.1"],
            &["application/json"],
            &["application/openmetrics-text;q=2, text/plain;q=0.1"],
            &["", ";", "q=1"],
        ] {
            assert_eq!(preferred(text), Exposition::Text, "{text:?}");
        }
    }
}
