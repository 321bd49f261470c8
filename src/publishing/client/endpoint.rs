//! Where a stream comes from, and why there is none.

use std::str::FromStr;
use std::{fmt, io};

use trifacet_wire::stream::MessageError;

/// Where a stream comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// A daemon's TCP server, as "host:port".
    Tcp(String),
    /// The local address, or the multicast group, as "host:port", to which a daemon sends datagrams.
    Udp(String),
    /// Where a daemon takes subscriptions to datagrams, as "host:port".
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

/// Why there is no stream, or no more of it.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The address cannot be read.
    #[error(
        "\"{0}\" is no address of a stream: it must be tcp://HOST:PORT, udp://HOST:PORT or subscribe://HOST:PORT"
    )]
    Endpoint(String),
    /// The address cannot be reached, or not be opened.
    #[error("cannot open {endpoint}: {source}")]
    Open {
        /// Which one.
        endpoint: Endpoint,
        /// What the system says.
        source: io::Error,
    },
    /// The daemon does not serve this client.
    #[error("{0}")]
    Refused(String),
    /// The stream has ended in order.
    #[error("the daemon closed the stream")]
    Closed,
    /// The stream broke.
    #[error("the stream broke: {0}")]
    Broken(#[from] io::Error),
    /// The other side says what this program cannot read.
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
