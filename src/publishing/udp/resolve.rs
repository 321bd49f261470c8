//! From the configured target to addresses: names, zones and interfaces, as they are at present.

use std::net::{IpAddr, SocketAddr, SocketAddrV6, ToSocketAddrs};
use std::os::unix::net::UnixDatagram;

use rustix::net::netdevice::{index_to_name, name_to_index};

use super::cause::Cause;
use crate::config::{Destination, Host, UdpTarget};

/// The present address of a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resolved {
    /// The address; for a zone, with the number of its interface.
    pub to: SocketAddr,
    /// Number of the interface for a multicast group, if it is configured by name.
    pub interface: Option<u32>,
}

/// Resolves a target. Blocks if its host is a name; everything else is known to this machine.
///
/// # Errors
/// The name has no address, or an interface does not exist.
pub fn resolve(target: &UdpTarget) -> Result<Resolved, Cause> {
    let to = address(&target.address)?;
    // An interface given by its IPv4 address is looked up by the system.
    let named = target.interface.as_deref().filter(|name| name.parse::<IpAddr>().is_err());
    Ok(Resolved { to, interface: named.map(interface_number).transpose()? })
}

/// Resolves a host. Blocks if it is a name.
///
/// # Errors
/// The name has no address, or the interface does not exist.
pub fn address(Destination { host, port }: &Destination) -> Result<SocketAddr, Cause> {
    match host {
        Host::Address(ip @ IpAddr::V6(v6)) if v6.is_unicast_link_local() => Err(Cause::Zone(*ip)),
        Host::Address(ip) => Ok(SocketAddr::new(*ip, *port)),
        Host::Zoned(ip, zone) => Ok(SocketAddrV6::new(*ip, *port, 0, interface_number(zone)?).into()),
        Host::Name(name) => {
            let unknown = |why: String| Cause::Name { name: name.clone(), why };
            let mut found = (name.as_str(), *port).to_socket_addrs().map_err(|e| unknown(e.to_string()))?;
            found.next().ok_or_else(|| unknown("the answer contains no address".into()))
        }
    }
}

/// The number of an interface, given by its name or its number.
fn interface_number(name: &str) -> Result<u32, Cause> {
    let missing = |_| Cause::Interface(name.to_owned());
    let any = UnixDatagram::unbound().map_err(|e| Cause::Socket(e.raw_os_error().unwrap_or_default()))?;
    match name.parse() {
        Ok(number) => index_to_name(&any, number).map(|_| number).map_err(missing),
        Err(_) => name_to_index(&any, name).map_err(missing),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolved(address: &str, interface: Option<&str>) -> Result<Resolved, String> {
        let address: Destination = address.parse().unwrap();
        let target = UdpTarget { interface: interface.map(str::to_owned), ..UdpTarget::to(address) };
        resolve(&target).map_err(|cause| cause.to_string())
    }

    #[test]
    fn zones_and_interfaces_become_numbers() {
        let lo = interface_number("lo").unwrap();
        let found = resolved("[fe80::1%lo]:5", None).unwrap();
        assert!(matches!(found.to, SocketAddr::V6(to) if to.scope_id() == lo && to.port() == 5), "{found:?}");
        assert_eq!(resolved(&format!("[fe80::1%{lo}]:5"), None), Ok(found));
        assert_eq!(resolved("239.255.0.1:5", Some("lo")).unwrap().interface, Some(lo));
        assert_eq!(resolved("239.255.0.1:5", Some("127.0.0.1")).unwrap().interface, None);
    }

    #[test]
    fn what_does_not_exist_is_named() {
        for (address, interface, told) in [
            ("[fe80::1%no-such-if]:5", None, "there is no interface no-such-if"),
            ("[fe80::1%4000000]:5", None, "there is no interface 4000000"),
            ("239.255.0.1:5", Some("no-such-if"), "there is no interface no-such-if"),
            ("[fe80::1]:5", None, "[fe80::1%eth0]"),
            ("no-such-host.invalid:5", None, "no-such-host.invalid cannot be resolved"),
        ] {
            let cause = resolved(address, interface).unwrap_err();
            assert!(cause.contains(told), "{address}: {cause}");
        }
    }
}
