//! `[monitor]`: health, metrics and the live page.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

use super::{check::Checker, publishing::address_or_off};

/// `[monitor]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MonitorConfig {
    /// Where browsers and scrapers connect; none (`"off"` in the file) switches the server off.
    #[serde(deserialize_with = "address_or_off")]
    pub listen: Option<SocketAddr>,
    /// Names that a request may be addressed to, besides `localhost` and the address that it came to.
    pub allowed_hosts: Vec<String>,
}

impl Default for MonitorConfig {
    fn default() -> Self {
        Self { listen: Some(([127, 0, 0, 1], 7360).into()), allowed_hosts: Vec::new() }
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
    }
}

fn is_host_name(name: &str) -> bool {
    let part = |part: &str| {
        (1..=63).contains(&part.len()) && part.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-')
    };
    name.len() <= 253 && name.split('.').all(part)
}
