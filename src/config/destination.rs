//! Host and port on the network: an address, an address with a zone, or the name of a host.

use std::fmt;
use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::str::FromStr;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Host and port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Destination {
    /// The host.
    pub host: Host,
    /// The port.
    pub port: u16,
}

/// The host of a [`Destination`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Host {
    /// An address, unicast or multicast.
    Address(IpAddr),
    /// An address that is valid on one interface only: its name or number is the zone.
    Zoned(Ipv6Addr, String),
    /// A name, which the system resolves.
    Name(String),
}

/// A text that is not a [`Destination`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("allowed is {}", Destination::ALLOWED)]
pub struct DestinationError;

impl Destination {
    /// The allowed forms.
    pub const ALLOWED: &str = "an address and a port such as \"127.0.0.1:7361\", \"[::1]:7361\" or \
                               \"[fe80::1%eth0]:7361\", or the name of a host and a port such as \"plc.lan:7361\"";

    /// Whether this is the address of a multicast group.
    pub fn is_multicast(&self) -> bool {
        match &self.host {
            Host::Address(ip) => ip.is_multicast(),
            Host::Zoned(ip, _) => ip.is_multicast(),
            Host::Name(_) => false,
        }
    }

    /// Whether this is an IPv4 address.
    pub fn is_ipv4(&self) -> bool {
        matches!(self.host, Host::Address(IpAddr::V4(_)))
    }
}

impl From<SocketAddr> for Destination {
    fn from(address: SocketAddr) -> Self {
        let host = match address {
            SocketAddr::V6(v6) if v6.scope_id() != 0 => Host::Zoned(*v6.ip(), v6.scope_id().to_string()),
            _ => Host::Address(address.ip()),
        };
        Self { host, port: address.port() }
    }
}

impl FromStr for Destination {
    type Err = DestinationError;

    fn from_str(text: &str) -> Result<Self, DestinationError> {
        if let Ok(address) = text.parse::<SocketAddr>() {
            return Ok(address.into());
        }
        let (host, port) = text.rsplit_once(':').ok_or(DestinationError)?;
        let port = port.parse().map_err(|_| DestinationError)?;
        let host = match host.strip_prefix('[').and_then(|host| host.strip_suffix(']')) {
            Some(inner) => {
                let (ip, zone) = inner.split_once('%').ok_or(DestinationError)?;
                let ip = ip.parse().map_err(|_| DestinationError)?;
                is_interface(zone).then(|| Host::Zoned(ip, zone.to_owned()))
            }
            None => is_name(host).then(|| Host::Name(host.to_owned())),
        };
        Ok(Self { host: host.ok_or(DestinationError)?, port })
    }
}

impl fmt::Display for Destination {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { host, port } = self;
        match host {
            Host::Address(ip) => SocketAddr::new(*ip, *port).fmt(f),
            Host::Zoned(ip, zone) => write!(f, "[{ip}%{zone}]:{port}"),
            Host::Name(name) => write!(f, "{name}:{port}"),
        }
    }
}

impl Serialize for Destination {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Destination {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        String::deserialize(from)?.parse().map_err(D::Error::custom)
    }
}

/// Whether an interface can have this name.
pub(super) fn is_interface(text: &str) -> bool {
    !text.is_empty() && text.len() < 16 && !text.contains(|c: char| c.is_whitespace() || "/:%]".contains(c))
}

/// Whether a host can have this name. Digits and dots alone are a mistyped address.
fn is_name(text: &str) -> bool {
    let label = |label: &str| {
        let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        (1..=63).contains(&label.len()) && label.chars().all(allowed) && !label.starts_with('-')
    };
    let last = text.rsplit('.').next().unwrap_or_default();
    text.len() <= 253 && text.split('.').all(label) && !last.chars().all(|c| c.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_is_read_and_written_alike() {
        for text in [
            "10.0.0.1:7362",
            "[::1]:7362",
            "[fe80::1%eth0]:7362",
            "[fe80::1%3]:7362",
            "[ff02::1%br-lan]:1",
            "plc:7362",
            "plc-7.hall_2.example.org:65535",
            "4u.lan:1",
        ] {
            assert_eq!(text.parse::<Destination>().unwrap().to_string(), text);
        }
        let zoned: Destination = "[fe80::1%eth0]:7362".parse().unwrap();
        assert_eq!(zoned.host, Host::Zoned("fe80::1".parse().unwrap(), "eth0".into()));
    }

    #[test]
    fn mistyped_addresses_are_not_names() {
        for text in [
            "",
            "plc",
            ":7362",
            "plc:",
            "plc:70000",
            "plc:udp",
            "1.2.3:7362",
            "256.1.1.1:7362",
            "10.0.0.1.:7362",
            "fe80::1%eth0:7362",
            "[fe80::1%]:7362",
            "[fe80::1%a name]:7362",
            "[plc]:7362",
            "[10.0.0.1%eth0]:7362",
            "-plc:7362",
            "plc..lan:7362",
            "udp://plc:7362",
            "a b:7362",
        ] {
            assert_eq!(text.parse::<Destination>(), Err(DestinationError), "{text}");
        }
    }
}
