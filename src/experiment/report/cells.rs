//! HTML tables and the format of numbers in them.

use std::fmt::Write;

use crate::experiment::three;

/// Escapes text for HTML.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('{', "&#123;")
}

/// A table. The first cell of each row is its heading.
pub(super) fn table(head: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let mut html = String::from("<div class=\"scroll\"><table><thead><tr>");
    for cell in head {
        let _ = write!(html, "<th scope=\"col\">{cell}</th>");
    }
    html.push_str("</tr></thead><tbody>");
    for row in rows {
        html.push_str("<tr>");
        for (i, cell) in row.iter().enumerate() {
            let _ = if i == 0 {
                write!(html, "<th scope=\"row\">{cell}</th>")
            } else {
                write!(html, "<td>{cell}</td>")
            };
        }
        html.push_str("</tr>");
    }
    html + "</tbody></table></div>"
}

/// Formats metres or radians in um or urad.
pub(super) fn micro(x: f64) -> String {
    three(x * 1e6)
}

/// Formats a fraction as percentage.
pub(super) fn percent(x: f64) -> String {
    format!("{} %", three(x * 1e2))
}

/// Marks a value from the paper.
pub(super) fn paper(said: &str) -> String {
    format!("<span class=\"paper\">{said}</span>")
}

/// Formats a time without trailing zeros.
pub(super) fn seconds(s: f64) -> String {
    format!("{} s", three(s).parse::<f64>().unwrap_or(s))
}

/// A value with its standard uncertainty, which is shown with two significant digits.
pub(super) fn with_sigma(value: f64, sigma: f64) -> String {
    let digits = if sigma > 0.0 { (1 - sigma.log10().floor() as i32).clamp(0, 9) as usize } else { 4 };
    let value = format!("{value:.digits$}");
    // Zero has no sign after rounding.
    let value = value.strip_prefix('-').filter(|x| x.parse() == Ok(0.0)).unwrap_or(&value);
    format!("{value} <small>± {sigma:.digits$}</small>")
}
