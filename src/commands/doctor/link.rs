//! What is wrong between here and the daemon.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio::time::timeout;
use trifacet::client::{ClientError, Endpoint, Losses, MessageError};
use trifacet::config::Config;

use super::frames::Seen;
use super::{Report, port};

/// The endpoint cannot be opened.
pub(super) fn not_open(endpoint: &Endpoint, error: &ClientError, config: &Config, report: &mut Report) {
    let source = match error {
        ClientError::Open { source, .. } => source,
        other => return broken(other, report),
    };
    let what = format!("{endpoint} cannot be opened: {source}");
    match (endpoint, source.kind()) {
        (Endpoint::Tcp(_), io::ErrorKind::ConnectionRefused) => {
            let configured = match config.publishing.tcp {
                Some(address) => format!("the configuration has it at {address}"),
                None => "the configuration has switched it off ([publishing] tcp)".into(),
            };
            report.wrong(
                &format!("the port is closed: nothing listens at {endpoint}"),
                &format!("is the daemon running (trifacet run, or systemctl status trifacet)? {configured}; one that listens at 127.0.0.1 is reached from its own machine only"),
            );
        }
        (Endpoint::Subscribe(_), io::ErrorKind::ConnectionRefused) => report.wrong(
            &format!("the port is closed: nothing takes subscriptions at {endpoint}"),
            "is the daemon running, and does its [publishing] subscribe have this address?",
        ),
        (_, io::ErrorKind::TimedOut) => report.wrong(
            &format!("{endpoint} does not answer"),
            "is that the right machine, is it on, and does no firewall drop packets to this port?",
        ),
        (_, io::ErrorKind::AddrInUse) => {
            let port = endpoint.to_string().rsplit_once(':').and_then(|(_, port)| port.parse().ok());
            let holder = port.and_then(port::holder);
            let holder = holder.unwrap_or_else(|| "a process that this user cannot see".into());
            report.wrong(
                &format!("the port of {endpoint} is taken by {holder}"),
                "one process receives at an address: end that one, or send to another port ([publishing] udp)",
            );
        }
        (_, io::ErrorKind::AddrNotAvailable) => report.wrong(
            &what,
            "no interface of this machine has this address (ip address shows them): udp:// takes the receiver's own address, or 0.0.0.0 for all",
        ),
        (_, io::ErrorKind::NetworkUnreachable | io::ErrorKind::HostUnreachable) => {
            report.wrong(&what, "there is no way to that network: is the right interface up (ip route)?");
        }
        (_, io::ErrorKind::PermissionDenied) => {
            report.wrong(&what, "this user may not: ports below 1024 are for root, and a firewall may forbid others");
        }
        _ => report.wrong(&what, "is the name or the interface right?"),
    }
}

/// The link was open, and is no more.
pub(super) fn broken(error: &ClientError, report: &mut Report) {
    let what = error.to_string();
    match error {
        ClientError::Refused(why) if why.contains("allow") => report.wrong(
            &format!("refused: {what}"),
            "add this machine's network to [publishing] allow of the daemon's configuration, and restart it",
        ),
        ClientError::Refused(_) => report.wrong(
            &format!("refused: {what}"),
            "end clients that are not needed, or raise [publishing] tcp_clients, or subscribers",
        ),
        ClientError::Message(MessageError::Version { .. }) => {
            report.wrong(&what, "install the same version of trifacet on both sides");
        }
        ClientError::Message(_) => report.wrong(&what, "is it trifacet, of this version, that sends there?"),
        ClientError::Closed => {
            report.wrong(&what, "does the daemon end just now (its log says why), or is it another program?");
        }
        _ => report.wrong(&what, "the daemon's log says more"),
    }
}

/// The link is open, and no frame comes.
pub(super) async fn silent(
    endpoint: &Endpoint,
    seen: &Seen,
    losses: Losses,
    config: &Config,
    report: &mut Report,
) {
    match (endpoint, losses.skipped_bytes) {
        (_, n @ 1..) => report.wrong(
            &format!("{n} bytes arrive that are none of this stream"),
            "another program sends there: look for it, or use another port",
        ),
        (Endpoint::Tcp(_), _) if seen.heartbeat.is_some() => report.wrong(
            "heartbeats arrive, but no frames",
            "the fast side of the daemon is stuck: its log says more; restart it, and report it",
        ),
        (Endpoint::Tcp(_), _) => report.wrong(
            "something accepts connections and says nothing",
            "is it trifacet that listens there, in a version that knows the stream command?",
        ),
        (Endpoint::Subscribe(_), _) => report.wrong(
            "the subscription is granted, but no frame arrives",
            "does a firewall let only short exchanges through? Otherwise the fast side of the daemon is stuck: see its log",
        ),
        (Endpoint::Udp(place), _) => nothing_sent(place, config, report).await,
    }
}

/// Datagrams do not come: is this where they should, and does a daemon send them?
async fn nothing_sent(place: &str, config: &Config, report: &mut Report) {
    let targets = &config.publishing.udp;
    let here: Option<SocketAddr> = place.parse().ok();
    let meant = targets.iter().find(|target| {
        here.is_none_or(|here| {
            let any = here.ip().is_unspecified() || here.ip() == target.address.ip();
            any && here.port() == target.address.port()
        })
    });
    let Some(target) = meant else {
        let all: Vec<_> = targets.iter().map(|target| target.address.to_string()).collect();
        let all = if all.is_empty() { "nowhere".into() } else { all.join(", ") };
        return report.wrong(
            &format!("no datagram arrives, and the configuration sends none to {place}: it sends to {all}"),
            "add this address to [publishing] udp, or listen where they are sent (--config names the daemon's file)",
        );
    };
    report.good(&format!("the configuration sends to {}", target.address));
    match config.publishing.tcp {
        Some(tcp) => match timeout(Duration::from_secs(1), ask_status(tcp)).await {
            Ok(Ok(line)) => {
                report.good(&format!("a daemon answers at tcp://{tcp}: {line}"));
                let multicast = target.address.ip().is_multicast();
                report.wrong(
                    "it sends, and nothing arrives",
                    if multicast {
                        "is the group heard through the right interface (--interface here, interface = in the daemon), and is ttl large enough?"
                    } else {
                        "does it run with this configuration (config id in its status)? Does a firewall here drop UDP? Is the address that of this machine?"
                    },
                );
            }
            _ => report.wrong(
                &format!("no datagram arrives, and no daemon answers at tcp://{tcp}"),
                "start the daemon (trifacet run), or look at its log",
            ),
        },
        None => report.wrong(
            "no datagram arrives",
            "is the daemon running, and does no firewall stand between? With [publishing] tcp switched on this could be told",
        ),
    }
}

async fn ask_status(tcp: SocketAddr) -> io::Result<String> {
    let mut stream = BufReader::new(TcpStream::connect(tcp).await?);
    stream.get_mut().write_all(b"status?\n").await?;
    let mut line = String::new();
    stream.read_line(&mut line).await?;
    Ok(line.trim_end().to_owned())
}
