//! `[publishing]`: outlets of the pose stream.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use trifacet_wire::PoseFrame;

use super::check::Checker;
use super::destination::{Destination, Host, is_interface};
use super::network::Network;
use super::text::or_off;

/// Settings of `[publishing]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PublishingConfig {
    /// Address for TCP clients. `None` (`"off"` in the file) disables the server.
    #[serde(deserialize_with = "address_or_off", serialize_with = "or_off")]
    pub tcp: Option<SocketAddr>,
    /// Largest number of TCP clients at a time.
    pub tcp_clients: usize,
    /// Number of frames that may wait for a TCP client before the oldest are dropped.
    pub tcp_queue: usize,
    /// Networks whose hosts may connect and subscribe.
    pub allow: Vec<Network>,
    /// Targets of the datagrams.
    pub udp: Vec<UdpTarget>,
    /// Address at which receivers subscribe to datagrams. `None` (`"off"` in the file) disables it.
    #[serde(deserialize_with = "address_or_off", serialize_with = "or_off")]
    pub subscribe: Option<SocketAddr>,
    /// Largest number of subscribers at a time.
    pub subscribers: usize,
    /// Which standard uncertainties the frames of 192 bytes carry.
    pub deviations: Deviations,
}

/// Which standard uncertainties a frame carries.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Deviations {
    /// Random and systematic part together.
    #[default]
    Total,
    /// The random part, for receivers that average or filter the poses.
    Random,
}

impl Deviations {
    /// The name in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Total => "total",
            Self::Random => "random",
        }
    }

    /// The frame with these standard uncertainties, of a frame with the total.
    pub fn stated(self, frame: &PoseFrame) -> PoseFrame {
        let of = |total: f32, part: f32| {
            let random = (f64::from(total).powi(2) - f64::from(part).powi(2)).max(0.0).sqrt() as f32;
            if total.is_finite() { random } else { total }
        };
        match frame.systematic {
            Some(part) if self == Self::Random => {
                let deviations = std::array::from_fn(|i| of(frame.deviations[i], part[i]));
                PoseFrame { deviations, ..*frame }
            }
            _ => *frame,
        }
    }
}

/// A target of datagrams: an address, or a table with options.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct UdpTarget {
    /// Host and port of the target.
    pub address: Destination,
    /// Only frames whose sequence number is a multiple of this are sent.
    pub divider: u32,
    /// Whether the frames are in network byte order.
    pub big_endian: bool,
    /// Whether a frame without a valid pose carries the last valid pose instead of NaN.
    pub held: bool,
    /// Multicast only: name or IPv4 address of the interface. `None`: the system's routes decide.
    pub interface: Option<String>,
    /// Multicast only: time to live, one more than the number of routers that may forward a datagram.
    pub ttl: Option<u32>,
}

impl UdpTarget {
    /// A target that receives every frame.
    pub fn to(address: impl Into<Destination>) -> Self {
        let address = address.into();
        Self { address, divider: 1, big_endian: false, held: false, interface: None, ttl: None }
    }

    fn check(&self, mut at: Checker<'_>) {
        let Self { address, divider, interface, ttl, .. } = self;
        at.demand(address.port != 0, "", address, "a port from 1 to 65535");
        at.number("divider", *divider, 1.0..=1_000_000.0);
        at.optional("ttl", *ttl, 1.0..=255.0);
        let multicast = address.is_multicast();
        let only = "absent, unless the address is multicast (224.0.0.0/4, ff00::/8)";
        at.demand(multicast || ttl.is_none(), "ttl", ttl.unwrap_or_default(), only);
        if let Some(interface) = interface {
            at.demand(multicast, "interface", interface, only);
            let zone = matches!(address.host, Host::Zoned(..));
            at.demand(!zone, "interface", interface, "absent: the zone of the address names the interface");
            let named = is_interface(interface) && interface.parse::<IpAddr>().is_err();
            let own = address.is_ipv4() && interface.parse::<Ipv4Addr>().is_ok();
            let allowed = "the name of an interface such as \"eth0\", or, for IPv4, its address";
            at.demand(named || own, "interface", interface, allowed);
        }
    }
}

impl Default for PublishingConfig {
    fn default() -> Self {
        Self {
            tcp: Some(([127, 0, 0, 1], 7361).into()),
            tcp_clients: 64,
            tcp_queue: 1024,
            allow: Network::loopback(),
            udp: vec![UdpTarget::to(SocketAddr::from(([127, 0, 0, 1], 7362)))],
            subscribe: None,
            subscribers: 32,
            deviations: Deviations::Total,
        }
    }
}

impl PublishingConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("tcp_clients", self.tcp_clients as f64, 1.0..=1024.0);
        at.number("tcp_queue", self.tcp_queue as f64, 1.0..=65_536.0);
        at.demand(self.allow.len() <= 64, "allow", self.allow.len(), "at most 64 networks");
        at.demand(self.udp.len() <= 32, "udp", self.udp.len(), "at most 32 addresses");
        for (i, target) in self.udp.iter().enumerate() {
            let key = format!("udp[{i}]");
            let same =
                |other: &UdpTarget| other.address == target.address && other.interface == target.interface;
            at.demand(!self.udp[..i].iter().any(same), &key, &target.address, "each address once");
            target.check(at.section(&key));
        }
        if let Some(own) = self.subscribe {
            let taken = self.udp.iter().any(|target| target.address == own.into());
            at.demand(!taken, "subscribe", own, "an address that is not a target in publishing.udp");
        }
        at.number("subscribers", self.subscribers as f64, 1.0..=1024.0);
    }
}

const ADDRESS: &str = "an address and a port such as \"127.0.0.1:7361\" or \"[::1]:7361\"";

pub(super) fn address_or_off<'de, D: Deserializer<'de>>(from: D) -> Result<Option<SocketAddr>, D::Error> {
    let text = String::deserialize(from)?;
    if text == "off" {
        return Ok(None);
    }
    text.parse().map(Some).map_err(|_| D::Error::custom(format_args!("allowed is {ADDRESS}, or \"off\"")))
}

/// The table form of a target.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    address: Destination,
    #[serde(default = "one")]
    divider: u32,
    #[serde(default)]
    big_endian: bool,
    #[serde(default)]
    held: bool,
    interface: Option<String>,
    ttl: Option<u32>,
}

fn one() -> u32 {
    1
}

impl<'de> Deserialize<'de> for UdpTarget {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Either;
        impl<'de> Visitor<'de> for Either {
            type Value = UdpTarget;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{}, or a table with such an address", Destination::ALLOWED)
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<UdpTarget, E> {
                text.parse::<Destination>().map(UdpTarget::to).map_err(E::custom)
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<UdpTarget, A::Error> {
                let Table { address, divider, big_endian, held, interface, ttl } =
                    Table::deserialize(MapAccessDeserializer::new(map))?;
                Ok(UdpTarget { address, divider, big_endian, held, interface, ttl })
            }
        }
        from.deserialize_any(Either)
    }
}
