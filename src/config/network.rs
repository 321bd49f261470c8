//! Networks in access lists.

use std::fmt;
use std::net::IpAddr;
use std::str::FromStr;

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A range of addresses with a common prefix, such as "10.1.0.0/16" or "fd00::/8", or a single address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Network {
    address: IpAddr,
    bits: u8,
}

const ALLOWED: &str = "a network such as \"192.168.1.0/24\" or \"fd00::/8\", or a single address";

impl Network {
    /// The addresses of this machine itself.
    pub fn loopback() -> Vec<Self> {
        let v4 = Self { address: [127, 0, 0, 0].into(), bits: 8 };
        let v6 = Self { address: std::net::Ipv6Addr::LOCALHOST.into(), bits: 128 };
        vec![v4, v6]
    }

    /// Whether an address belongs to the network. An IPv4-mapped IPv6 address counts as an IPv4 address.
    pub fn contains(self, address: IpAddr) -> bool {
        match (self.address, address.to_canonical()) {
            (IpAddr::V4(own), IpAddr::V4(other)) => {
                let differs = own.to_bits() ^ other.to_bits();
                differs.checked_shr(u32::from(32 - self.bits)).unwrap_or(0) == 0
            }
            (IpAddr::V6(own), IpAddr::V6(other)) => {
                let differs = own.to_bits() ^ other.to_bits();
                differs.checked_shr(u32::from(128 - self.bits)).unwrap_or(0) == 0
            }
            _ => false,
        }
    }

    /// The first address of the network.
    fn base(self) -> IpAddr {
        match self.address {
            IpAddr::V4(own) => {
                let mask = u32::MAX.checked_shl(u32::from(32 - self.bits)).unwrap_or(0);
                IpAddr::V4((own.to_bits() & mask).into())
            }
            IpAddr::V6(own) => {
                let mask = u128::MAX.checked_shl(u32::from(128 - self.bits)).unwrap_or(0);
                IpAddr::V6((own.to_bits() & mask).into())
            }
        }
    }

    /// Whether the network contains only addresses of this machine.
    pub fn is_loopback(self) -> bool {
        self.address.is_loopback() && self.bits >= if self.address.is_ipv4() { 8 } else { 128 }
    }
}

/// Why a text is not a network.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NetworkError {
    /// The address or the length of the prefix is invalid.
    #[error("allowed is {ALLOWED}")]
    Form,
    /// The address is not the first one of the network.
    #[error("{text} is not a network: its first address is {first}; a single address has no /")]
    NotFirst {
        /// The text.
        text: String,
        /// The network that contains the address.
        first: Network,
    },
}

impl FromStr for Network {
    type Err = NetworkError;

    fn from_str(text: &str) -> Result<Self, NetworkError> {
        let (address, bits) = text.split_once('/').map_or((text, None), |(a, b)| (a, Some(b)));
        let address: IpAddr = address.parse().map_err(|_| NetworkError::Form)?;
        let most = if address.is_ipv4() { 32 } else { 128 };
        let bits = bits.map_or(Ok(most), str::parse).map_err(|_| NetworkError::Form)?;
        if bits > most {
            return Err(NetworkError::Form);
        }
        let network = Self { address, bits };
        let base = network.base();
        if address != base {
            let first = Self { address: base, bits };
            return Err(NetworkError::NotFirst { text: text.to_owned(), first });
        }
        Ok(network)
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.address, self.bits)
    }
}

impl Serialize for Network {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Network {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Text;
        impl Visitor<'_> for Text {
            type Value = Network;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(ALLOWED)
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<Network, E> {
                text.parse().map_err(E::custom)
            }
        }
        // Parsed within the visitor, so that an error is located at this entry and not at the list.
        from.deserialize_str(Text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contains(network: &str, address: &str) -> bool {
        network.parse::<Network>().unwrap().contains(address.parse().unwrap())
    }

    #[test]
    fn networks_contain_addresses_with_the_same_prefix() {
        assert!(contains("127.0.0.0/8", "127.255.0.1") && !contains("127.0.0.0/8", "128.0.0.1"));
        assert!(contains("10.1.2.3", "10.1.2.3") && !contains("10.1.2.3/32", "10.1.2.2"));
        assert!(contains("10.1.2.2/31", "10.1.2.3") && contains("0.0.0.0/0", "255.1.2.3"));
        assert!(contains("fd00::/8", "fdff::1") && !contains("fd00::/8", "fe00::1"));
        assert!(contains("::/0", "1::") && contains("::1", "::1") && !contains("::1", "::2"));
        assert!(contains("127.0.0.0/8", "::ffff:127.0.0.1"), "a dual-stack socket reports mapped addresses");
        assert!(!contains("0.0.0.0/0", "::1") && !contains("::/0", "127.0.0.1"));
    }

    #[test]
    fn invalid_networks_are_refused() {
        for bad in ["", "10.0.0.0/33", "::/129", "10.0.0/8", "10.0.0.0/", "10.0.0.0/-1", "lab", "1.2.3.4:5"] {
            assert!(bad.parse::<Network>().unwrap_err().to_string().contains("192.168.1.0/24"), "{bad}");
        }
        for (bad, first) in
            [("10.1.2.3/16", "10.1.0.0/16"), ("1.1.1.1/0", "0.0.0.0/0"), ("fd00::1/8", "fd00::/8")]
        {
            assert!(bad.parse::<Network>().unwrap_err().to_string().contains(first), "{bad}");
        }
    }
}
