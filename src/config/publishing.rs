//! `[publishing]`: where poses go.

use std::net::SocketAddr;

use serde::{Deserialize, Deserializer, de::Error};

use super::{check::Checker, network::Network};

/// `[publishing]`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PublishingConfig {
    /// Where TCP clients connect; none (`"off"` in the file) switches the server off.
    #[serde(deserialize_with = "address_or_off")]
    pub tcp: Option<SocketAddr>,
    /// Most TCP clients at a time.
    pub tcp_clients: usize,
    /// Frames that a TCP client may be behind before the oldest are dropped.
    pub tcp_queue: usize,
    /// Who may connect, and subscribe.
    pub allow: Vec<Network>,
    /// Where datagrams go.
    #[serde(deserialize_with = "addresses")]
    pub udp: Vec<SocketAddr>,
}

impl Default for PublishingConfig {
    fn default() -> Self {
        Self {
            tcp: Some(([127, 0, 0, 1], 7361).into()),
            tcp_clients: 64,
            tcp_queue: 1024,
            allow: Network::loopback(),
            udp: vec![([127, 0, 0, 1], 7362).into()],
        }
    }
}

impl PublishingConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("tcp_clients", self.tcp_clients as f64, 1.0..=1024.0);
        at.number("tcp_queue", self.tcp_queue as f64, 1.0..=65_536.0);
        at.demand(self.allow.len() <= 64, "allow", self.allow.len(), "at most 64 networks");
        at.demand(self.udp.len() <= 32, "udp", self.udp.len(), "at most 32 addresses");
        for (i, address) in self.udp.iter().enumerate() {
            let key = format!("udp[{i}]");
            at.demand(address.port() != 0, &key, address, "a port from 1 to 65535");
            at.demand(!self.udp[..i].contains(address), &key, address, "each address once");
        }
    }
}

const ADDRESS: &str = "an address and a port such as \"127.0.0.1:7361\" or \"[::1]:7361\"";

fn address_or_off<'de, D: Deserializer<'de>>(from: D) -> Result<Option<SocketAddr>, D::Error> {
    let text = String::deserialize(from)?;
    if text == "off" {
        return Ok(None);
    }
    text.parse().map(Some).map_err(|_| D::Error::custom(format_args!("allowed is {ADDRESS}, or \"off\"")))
}

fn addresses<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<SocketAddr>, D::Error> {
    /// One of them, so that an error is located at it and not at the list.
    #[derive(Deserialize)]
    struct Address(#[serde(deserialize_with = "address")] SocketAddr);
    Ok(Vec::<Address>::deserialize(from)?.into_iter().map(|a| a.0).collect())
}

fn address<'de, D: Deserializer<'de>>(from: D) -> Result<SocketAddr, D::Error> {
    let text = String::deserialize(from)?;
    text.parse().map_err(|_| D::Error::custom(format_args!("allowed is {ADDRESS}")))
}
