//! Where a running daemon is: its stream and its control socket.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use trifacet::client::Endpoint;
use trifacet::config::places::{SERVICE_SOCKET, control_socket};
use trifacet::config::{self, Config};
use trifacet::exit::{self, Failure};

/// The endpoint of a daemon with the default configuration.
const DEFAULT_ENDPOINT: &str = "127.0.0.1:7361";

/// The option of all commands that talk to a running daemon.
#[derive(Debug, Args)]
pub(crate) struct RunningArg {
    /// Configuration file of the daemon, which names its addresses
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

/// The options of commands that use the control socket.
#[derive(Debug, Args)]
pub(crate) struct SocketArg {
    /// Control socket of the daemon; by default that of the configuration, or else the one in $XDG_RUNTIME_DIR
    /// or in /run/trifacet
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
}

impl RunningArg {
    fn load(&self) -> Result<Option<Config>> {
        Ok(self.config.as_deref().map(|file| config::load(Some(file))).transpose()?)
    }

    /// The stream: the one given, else that of the configuration, else that of the default configuration.
    pub(crate) fn endpoint(&self, given: Option<&Endpoint>) -> Result<Endpoint> {
        match (given, self.load()?) {
            (Some(endpoint), _) => Ok(endpoint.clone()),
            (None, Some(config)) => configured(&config),
            (None, None) => Ok(Endpoint::Tcp(DEFAULT_ENDPOINT.into())),
        }
    }

    /// The control socket: the one given, else that of the configuration, else the first default place with a
    /// socket.
    ///
    /// # Errors
    /// Fails if the configuration has no control socket.
    pub(crate) fn socket(&self, given: &SocketArg) -> Result<PathBuf> {
        if let Some(socket) = &given.socket {
            return Ok(socket.clone());
        }
        if let Some(config) = self.load()? {
            let file = self.config.as_deref().unwrap_or(Path::new("")).display();
            let why = format!("{file}: control.socket is \"off\", so the daemon takes no commands");
            return Ok(config.control.socket.ok_or_else(|| Failure::new(exit::UNAVAILABLE, why))?);
        }
        Ok(control_socket().filter(|socket| socket.exists()).unwrap_or_else(|| SERVICE_SOCKET.into()))
    }
}

/// The first outlet of the stream in a configuration.
pub(crate) fn configured(config: &Config) -> Result<Endpoint> {
    let publishing = &config.publishing;
    let local = |address: SocketAddr| {
        let ip = match address.ip() {
            ip if !ip.is_unspecified() => ip,
            IpAddr::V4(_) => Ipv4Addr::LOCALHOST.into(),
            IpAddr::V6(_) => Ipv6Addr::LOCALHOST.into(),
        };
        SocketAddr::new(ip, address.port()).to_string()
    };
    match (publishing.tcp, publishing.subscribe, publishing.udp.first()) {
        (Some(tcp), _, _) => Ok(Endpoint::Tcp(local(tcp))),
        (None, Some(subscribe), _) => Ok(Endpoint::Subscribe(local(subscribe))),
        (None, None, Some(target)) => Ok(Endpoint::Udp(target.address.to_string())),
        (None, None, None) => {
            let why = "the configuration publishes nothing: set tcp, subscribe or udp in [publishing]";
            Err(Failure::new(exit::UNAVAILABLE, why).into())
        }
    }
}
