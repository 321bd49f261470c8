//! Addresses of streams, and the errors of a client.

use std::str::FromStr;
use std::{fmt, io};

use trifacet_wire::stream::MessageError;

/// The address of a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// A daemon's TCP server, as "host:port".
    Tcp(String),
    /// The local address or multicast group to which a daemon sends datagrams, as "host:port".
    Udp(String),
    /// The port where a daemon accepts subscriptions to datagrams, as "host:port".
    Subscribe(String),
}

impl FromStr for Endpoint {
    type Err = ClientError;

    fn from_str(text: &str) -> Result<Self, ClientError> {
        let bad = || ClientError::Endpoint(text.to_owned());
        let (scheme, place) = text.split_once("://").ok_or_else(bad)?;
        let (host, port) = place.rsplit_once(':').ok_or_else(bad)?;
        if host.is_empty() || port.parse::<u16>().is_err() {
            return Err(bad());
        }
        match scheme {
            "tcp" => Ok(Self::Tcp(place.to_owned())),
            "udp" => Ok(Self::Udp(place.to_owned())),
            "subscribe" => Ok(Self::Subscribe(place.to_owned())),
            _ => Err(bad()),
        }
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(place) => write!(f, "tcp://{place}"),
            Self::Udp(place) => write!(f, "udp://{place}"),
            Self::Subscribe(place) => write!(f, "subscribe://{place}"),
        }
    }
}

/// Why a stream cannot be opened or has ended.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The address has a wrong format.
    #[error(
        "\"{0}\" is not a stream address; allowed: tcp://HOST:PORT, udp://HOST:PORT, subscribe://HOST:PORT"
    )]
    Endpoint(String),
    /// The address cannot be reached or opened.
    #[error("cannot open {endpoint}: {source}")]
    Open {
        /// The address.
        endpoint: Endpoint,
        /// The error of the system.
        source: io::Error,
    },
    /// The daemon does not serve this client.
    #[error("{0}")]
    Refused(String),
    /// The daemon closed the stream in order.
    #[error("the daemon closed the stream")]
    Closed,
    /// The connection broke.
    #[error("the stream broke: {0}")]
    Broken(#[from] io::Error),
    /// A message cannot be decoded.
    #[error(transparent)]
    Message(#[from] MessageError),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoints_are_checked() {
        assert_eq!("tcp://[::1]:7361".parse::<Endpoint>().unwrap(), Endpoint::Tcp("[::1]:7361".into()));
        assert_eq!("udp://lab:7362".parse::<Endpoint>().unwrap().to_string(), "udp://lab:7362");
        assert_eq!("subscribe://lab:1".parse::<Endpoint>().unwrap().to_string(), "subscribe://lab:1");
        for bad in ["127.0.0.1:7361", "http://a:1", "tcp://a", "tcp://:1", "udp://a:70000", ""] {
            let error = bad.parse::<Endpoint>().unwrap_err().to_string();
            assert!(error.contains("tcp://HOST:PORT"), "{error}");
        }
    }
}
