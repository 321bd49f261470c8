//! Checks the link from this machine to the daemon.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio::time::timeout;
use trifacet::client::{ClientError, Endpoint, Losses, MessageError};
use trifacet::config::{Config, UdpTarget};
use trifacet::publishing::udp::resolve;

use super::frames::ReceivedFrames;
use super::{Report, port};

/// Longest time to wait for the answer to a query.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);

/// Reports why the endpoint cannot be opened.
pub(super) fn not_open(endpoint: &Endpoint, error: &ClientError, config: &Config, report: &mut Report) {
    let source = match error {
        ClientError::Open { source, .. } => source,
        other => return broken(other, report),
    };
    let what = format!("{endpoint} cannot be opened: {source}");
    match (endpoint, source.kind()) {
        (Endpoint::Tcp(_), io::ErrorKind::ConnectionRefused) => {
            let configured = match config.publishing.tcp {
                Some(address) => format!("in the configuration it is {address}"),
                None => "it is off in the configuration ([publishing] tcp)".into(),
            };
            report.wrong(
                &format!("the port is closed: nothing listens at {endpoint}"),
                &format!("check that the daemon is running (trifacet run, or systemctl status trifacet). Address: {configured}; 127.0.0.1 can be reached only from the same machine"),
            );
        }
        (Endpoint::Subscribe(_), io::ErrorKind::ConnectionRefused) => report.wrong(
            &format!("the port is closed: no server for subscriptions at {endpoint}"),
            "check that the daemon is running and that its [publishing] subscribe has this address",
        ),
        (_, io::ErrorKind::TimedOut) => report.wrong(
            &format!("{endpoint} does not answer"),
            "check that this is the right machine, that it is on, and that no firewall drops packets to this port",
        ),
        (_, io::ErrorKind::AddrInUse) => {
            let port = endpoint.to_string().rsplit_once(':').and_then(|(_, port)| port.parse().ok());
            let holder = port.and_then(port::holder);
            let holder = holder.unwrap_or_else(|| "a process that this user cannot see".into());
            report.wrong(
                &format!("the port of {endpoint} is taken by {holder}"),
                "only one process can receive at an address: end that process, or send to another port ([publishing] udp)",
            );
        }
        (_, io::ErrorKind::AddrNotAvailable) => report.wrong(
            &what,
            "no interface of this machine has this address (see ip address): udp:// needs an address of the receiver, or 0.0.0.0 for all",
        ),
        (_, io::ErrorKind::NetworkUnreachable | io::ErrorKind::HostUnreachable) => {
            report.wrong(&what, "no route to that network: check that the right interface is up (ip route)");
        }
        (_, io::ErrorKind::PermissionDenied) => {
            report.wrong(&what, "no permission: ports below 1024 require root, and a firewall may forbid others");
        }
        _ => report.wrong(&what, "check the name and the interface"),
    }
}

/// Reports why the link was closed.
pub(super) fn broken(error: &ClientError, report: &mut Report) {
    let what = error.to_string();
    match error {
        ClientError::Refused(why) if why.contains("allow") => report.wrong(
            &format!("refused: {what}"),
            "add this machine's network to [publishing] allow of the daemon's configuration, and restart it",
        ),
        ClientError::Refused(_) => report.wrong(
            &format!("refused: {what}"),
            "end clients that are not needed, or raise tcp_clients or subscribers in [publishing]",
        ),
        ClientError::Message(MessageError::Version { .. }) => {
            report.wrong(&what, "install the same version of trifacet on both sides");
        }
        ClientError::Message(_) => {
            report.wrong(&what, "check that the sender is trifacet in a compatible version");
        }
        ClientError::Closed => {
            report.wrong(&what, "the daemon may have ended (see its log), or this is another program");
        }
        _ => report.wrong(&what, "see the daemon's log"),
    }
}

/// Reports why no frame arrives although the link is open.
pub(super) async fn silent(
    endpoint: &Endpoint,
    seen: &ReceivedFrames,
    losses: Losses,
    config: &Config,
    report: &mut Report,
) {
    match (endpoint, losses.skipped_bytes) {
        (_, n @ 1..) => report.wrong(
            &format!("{n} bytes arrive that do not belong to this stream"),
            "another program sends to this port: find it, or use another port",
        ),
        (Endpoint::Tcp(_), _) if seen.heartbeat.is_some() => report.wrong(
            "heartbeats arrive, but no frames",
            "the fast thread of the daemon has stalled: see its log, restart it, and report this",
        ),
        (Endpoint::Tcp(_), _) => report.wrong(
            "a program accepts connections but sends nothing",
            "check that it is trifacet, in a version that has the stream command",
        ),
        (Endpoint::Subscribe(_), _) => report.wrong(
            "the subscription is granted, but no frame arrives",
            "a firewall may pass only short exchanges; otherwise the fast thread of the daemon has stalled: see its log",
        ),
        (Endpoint::Udp(place), _) => nothing_sent(place, config, report).await,
    }
}

/// The configured target of datagrams to this address.
fn target<'c>(place: &str, config: &'c Config) -> Option<&'c UdpTarget> {
    let here: Option<SocketAddr> = place.parse().ok();
    config.publishing.udp.iter().find(|target| {
        here.is_none_or(|here| {
            let there = resolve::address(&target.address).map(|address| address.ip());
            here.port() == target.address.port && (here.ip().is_unspecified() || there == Ok(here.ip()))
        })
    })
}

/// The time between datagrams to this address: according to the daemon if it answers, otherwise according to
/// the configuration.
pub(super) async fn frame_period(place: &str, config: &Config) -> Option<Duration> {
    let status = match config.publishing.tcp {
        Some(tcp) => timeout(ANSWER_TIMEOUT, ask_status(tcp)).await.ok().and_then(Result::ok),
        None => None,
    };
    let told =
        status.as_deref().and_then(|line| line.split(' ').find_map(|pair| pair.strip_prefix("rate_hz=")));
    let configured = config.acquisition.rate_hz / f64::from(config.estimation.average);
    let rate_hz = told.and_then(|rate| rate.parse().ok()).unwrap_or(configured);
    let divider = target(place, config).map_or(1, |target| target.divider);
    Duration::try_from_secs_f64(f64::from(divider) / rate_hz).ok()
}

/// Reports why no datagrams arrive: wrong target, or no daemon.
async fn nothing_sent(place: &str, config: &Config, report: &mut Report) {
    let targets = &config.publishing.udp;
    let Some(target) = target(place, config) else {
        let all: Vec<_> = targets.iter().map(|target| target.address.to_string()).collect();
        let all = if all.is_empty() { "no address".into() } else { all.join(", ") };
        return report.wrong(
            &format!("no datagram arrives, and the configuration sends none to {place}: it sends to {all}"),
            "add this address to [publishing] udp, or listen at a configured address (--config: the daemon's file)",
        );
    };
    report.good(&format!("the configuration sends to {}", target.address));
    match config.publishing.tcp {
        Some(tcp) => match timeout(ANSWER_TIMEOUT, ask_status(tcp)).await {
            Ok(Ok(line)) => {
                report.good(&format!("a daemon answers at tcp://{tcp}: {line}"));
                let multicast = target.address.is_multicast();
                report.wrong(
                    "the daemon sends, but nothing arrives",
                    if multicast {
                        "check the interface for the group (--interface here, interface = in the daemon), and that ttl is large enough"
                    } else {
                        "check that it runs with this configuration (config id in its status), that no firewall here drops UDP, and that the address is one of this machine"
                    },
                );
            }
            _ => report.wrong(
                &format!("no datagram arrives, and no daemon answers at tcp://{tcp}"),
                "start the daemon (trifacet run), or see its log",
            ),
        },
        None => report.wrong(
            "no datagram arrives",
            "check that the daemon is running and no firewall is in between; with [publishing] tcp enabled, this command can distinguish the two",
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
