//! `[monitor]`: health, metrics and the live page.

use std::fmt;
use std::net::SocketAddr;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use subtle::ConstantTimeEq;

use super::check::Checker;
use super::publishing::address_or_off;
use super::text::or_off;

/// Settings of `[monitor]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MonitorConfig {
    /// Address of the HTTP server. `None` (`"off"` in the file) disables it.
    #[serde(deserialize_with = "address_or_off", serialize_with = "or_off")]
    pub listen: Option<SocketAddr>,
    /// Host names that a request may use, in addition to `localhost` and the address of the connection.
    pub allowed_hosts: Vec<String>,
    /// Whether the live page may steer.
    pub control: bool,
    /// Secret required for steering.
    pub token: Option<Token>,
}

/// A secret. No log, message or page shows it.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

impl Token {
    /// Dotted path of the key. Messages do not repeat its value.
    pub(super) const KEY: &str = "monitor.token";
    const LENGTH: std::ops::RangeInclusive<usize> = 16..=256;
    const ALLOWED: &str = "16 to 256 printable ASCII characters without spaces";

    /// Whether a given text is the token. The comparison takes the same time for all texts of the same
    /// length.
    pub fn is(&self, given: &str) -> bool {
        self.0.as_bytes().ct_eq(given.as_bytes()).into()
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("(secret)")
    }
}

impl<'de> Deserialize<'de> for Token {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // serde's own message would repeat the value.
        let wrong =
            |_| D::Error::custom(format!("allowed is a text in quotation marks, of {}", Token::ALLOWED));
        String::deserialize(deserializer).map(Token).map_err(wrong)
    }
}

impl Serialize for Token {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str("(secret)")
    }
}

impl Default for MonitorConfig {
    fn default() -> Self {
        Self {
            listen: Some(([127, 0, 0, 1], 7360).into()),
            allowed_hosts: Vec::new(),
            control: false,
            token: None,
        }
    }
}

impl MonitorConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        let names = &self.allowed_hosts;
        at.demand(names.len() <= 64, "allowed_hosts", names.len(), "at most 64 host names");
        for (i, name) in names.iter().enumerate() {
            let allowed = "the name of a host without port, such as \"lab-pc\" or \"lab-pc.example.org\"";
            at.demand(is_host_name(name), &format!("allowed_hosts[{i}]"), format!("{name:?}"), allowed);
        }
        if let Some(Token(token)) = &self.token {
            let fine = Token::LENGTH.contains(&token.len()) && token.bytes().all(|b| b.is_ascii_graphic());
            // Do not show the token: messages end up in logs.
            at.demand(
                fine,
                "token",
                format!("a token of {} characters", token.chars().count()),
                Token::ALLOWED,
            );
        } else {
            at.demand(!self.control, "token", "absent, with control = true", Token::ALLOWED);
        }
    }
}

fn is_host_name(name: &str) -> bool {
    let part = |part: &str| {
        (1..=63).contains(&part.len()) && part.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-')
    };
    name.len() <= 253 && name.split('.').all(part)
}

#[cfg(test)]
mod tests {
    use crate::config::parse;
    use crate::config::reload::reload;

    const SECRET: &str = "correct-horse-battery";

    #[test]
    fn control_needs_a_token_and_no_message_contains_it() {
        let config = |text: &str| parse(text, None).map_err(|e| e.to_string());
        let good = config(&format!("monitor.control = true\nmonitor.token = '{SECRET}'")).unwrap();
        let token = good.monitor.token.clone().unwrap();
        assert!(token.is(SECRET) && !token.is("") && !token.is("correct-horse-batterY"));
        assert!(!token.is("correct-horse-battery ") && !token.is("correct-horse"));
        let shown = format!("{good:?} {}", serde_json::to_string(&good).unwrap());
        assert!(!shown.contains(SECRET) && shown.contains("(secret)"));
        for [before, bad, after] in [
            ["'", "fifteen-letters", "'"],
            ["'", "sixteen letters!", "'"],
            ["'", "sixteen-l\u{e9}tters", "'"],
            ["", "1234567890123456789", ""],
            ["", "1234567890.5", ""],
            ["", "2026-01-02T03:04:05Z", ""],
            ["['", SECRET, "']"],
            ["{ a = '", SECRET, "' }"],
            ["", SECRET, ""],
        ] {
            let error = config(&format!("monitor.token = {before}{bad}{after}")).unwrap_err();
            assert!(error.contains("16 to 256 printable") || error.contains("must be quoted"), "{error}");
            assert!(error.starts_with("(defaults):1:") && !error.contains(bad), "{error}");
        }
        let error = config("monitor.control = true").unwrap_err();
        assert!(error.contains("control = true"), "{error}");
        // A different token is detected as a change, although it is not shown.
        let other = config("monitor.control = true\nmonitor.token = 'another-secret-token'").unwrap();
        assert_eq!(reload(&good, &good, &other).unwrap().refused, ["monitor.token"]);
    }
}
