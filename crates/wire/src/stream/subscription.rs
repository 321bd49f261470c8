//! Requests for datagrams under a lease, one ASCII line each.

use std::fmt;

use super::request::{CommandError, divider, harmless, on_or_off, wrong};

/// The longest lease, seconds.
pub const MAX_LEASE_S: u32 = 60;

/// The frames that a receiver of datagrams gets, and their format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delivery {
    /// Frames whose sequence number is divisible by this.
    pub divider: u32,
    /// Whether frames are in network byte order.
    pub big_endian: bool,
    /// Whether a frame without a valid pose carries the last valid one (`POSE_HELD`) instead of NaN.
    pub held: bool,
}

/// A request for datagrams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SubscriptionRequest {
    /// Starts or renews a subscription.
    Subscribe {
        /// Duration of the lease, seconds.
        lease_s: u32,
        /// The requested frames and their format.
        delivery: Delivery,
        /// The nonce from the challenge of the daemon.
        nonce: Option<u64>,
    },
    /// Ends a subscription.
    Unsubscribe {
        /// The nonce of the subscription.
        nonce: u64,
    },
}

/// The reason why a request for datagrams is not valid: what was found, and what is allowed. The text is short,
/// because an answer is at most twice as long as the request.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}; allowed: {}", .0.found, .0.allowed)]
pub struct SubscriptionError(#[from] CommandError);

impl SubscriptionRequest {
    /// Parses a datagram. Returns `None` if the datagram is not such a request and gets no answer.
    ///
    /// # Errors
    /// An option of the request is unknown, absent, or has an invalid value.
    pub fn parse(bytes: &[u8]) -> Option<Result<Self, SubscriptionError>> {
        let text = std::str::from_utf8(bytes).ok()?;
        let mut words = text.split_ascii_whitespace();
        match words.next()? {
            "subscribe" => Some(subscribe(words)),
            "unsubscribe" => Some(unsubscribe(words.next())),
            _ => None,
        }
    }
}

fn subscribe<'a>(options: impl Iterator<Item = &'a str>) -> Result<SubscriptionRequest, SubscriptionError> {
    let (mut lease, mut nonce_said) = (None, None);
    let mut delivery = Delivery { divider: 1, big_endian: false, held: false };
    for option in options {
        let found = harmless(option.as_bytes());
        match option.split_once('=').unwrap_or((option, "")) {
            ("lease_s", value) => lease = Some(lease_s(found, value)?),
            ("divider", value) => delivery.divider = divider(&found, value)?,
            ("held", value) => delivery.held = on_or_off(&found, value)?,
            ("big_endian", value) => delivery.big_endian = on_or_off(&found, value)?,
            ("nonce", value) => nonce_said = Some(nonce(found, value)?),
            _ => wrong(found, "lease_s= divider= held= big_endian= nonce=")?,
        }
    }
    match lease {
        Some(lease_s) => Ok(SubscriptionRequest::Subscribe { lease_s, delivery, nonce: nonce_said }),
        None => Ok(wrong("no lease_s", format!("lease_s=1 to {MAX_LEASE_S}"))?),
    }
}

fn unsubscribe(option: Option<&str>) -> Result<SubscriptionRequest, SubscriptionError> {
    let found = option.map_or_else(|| "no nonce".into(), |option| harmless(option.as_bytes()));
    match option.and_then(|option| option.strip_prefix("nonce=")) {
        Some(value) => Ok(SubscriptionRequest::Unsubscribe { nonce: nonce(found, value)? }),
        None => Ok(wrong(found, "unsubscribe nonce=HEX")?),
    }
}

fn lease_s(found: String, value: &str) -> Result<u32, CommandError> {
    match value.parse() {
        Ok(lease_s @ 1..=MAX_LEASE_S) => Ok(lease_s),
        _ => wrong(found, format!("1 to {MAX_LEASE_S}")),
    }
}

fn nonce(found: String, value: &str) -> Result<u64, CommandError> {
    u64::from_str_radix(value, 16).or_else(|_| wrong(found, "nonce=HEX"))
}

/// The request as sent by a client.
impl fmt::Display for SubscriptionRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Subscribe { lease_s, delivery: Delivery { divider, big_endian, held }, nonce } => {
                write!(f, "subscribe lease_s={lease_s} divider={divider}")?;
                for (name, on) in [("big_endian", big_endian), ("held", held)] {
                    if *on {
                        write!(f, " {name}=on")?;
                    }
                }
                nonce.map_or(Ok(()), |nonce| write!(f, " nonce={nonce:016x}"))
            }
            Self::Unsubscribe { nonce } => write!(f, "unsubscribe nonce={nonce:016x}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn requests_survive_a_round_trip(
            lease_s in 1..=MAX_LEASE_S, divider in 1..1_000_000u32, big_endian: bool, held: bool, nonce: Option<u64>,
        ) {
            let ask = SubscriptionRequest::Subscribe { lease_s, delivery: Delivery { divider, big_endian, held }, nonce };
            prop_assert_eq!(SubscriptionRequest::parse(ask.to_string().as_bytes()), Some(Ok(ask)));
        }
    }
}
