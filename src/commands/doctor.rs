//! `trifacet doctor`: finds out why no frames, or no valid poses, arrive, and what to do.

mod daemon;
mod frames;
mod link;
mod port;

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use frames::ReceivedFrames;
use tokio::time::{Instant, timeout, timeout_at};
use trifacet::client::{Client, ClientError, Endpoint, Options};
use trifacet::clock::SystemClock;
use trifacet::clock::utc::Utc;
use trifacet::config::Config;
use trifacet::exit::{self, Failure};
use trifacet_core::time::{Clock, Mono};

use super::running::configured;
use super::silence::{Heard, SHORTEST, Wait};
use super::{ConfigArg, written};

/// Time for which frames are collected.
const LOOK: Duration = Duration::from_secs(2);

/// Find out why no frames, or no valid poses, arrive, and what to do
#[derive(Debug, Args)]
pub(crate) struct DoctorArgs {
    /// Source of the stream, as for `watch`; by default that of the configuration
    endpoint: Option<Endpoint>,
    /// Receive a multicast group through this interface
    #[arg(long)]
    interface: Option<String>,
    #[command(flatten)]
    config: ConfigArg,
}

/// Results of the checks.
#[derive(Default)]
pub(super) struct Report {
    text: String,
    /// The first problem found.
    wrong: Option<String>,
}

impl Report {
    fn line(&mut self, mark: &str, what: &str, advice: &str) {
        // Writing to a String cannot fail.
        let _ = writeln!(self.text, "{mark:<6} {what}");
        if !advice.is_empty() {
            let _ = writeln!(self.text, "       -> {advice}");
        }
    }

    /// A check that passed.
    pub(super) fn good(&mut self, what: &str) {
        self.line("ok", what, "");
    }

    /// A finding with which poses remain valid.
    pub(super) fn note(&mut self, what: &str, advice: &str) {
        self.line("note", what, advice);
    }

    /// A problem that prevents valid poses.
    pub(super) fn wrong(&mut self, what: &str, advice: &str) {
        self.line("WRONG", what, advice);
        self.wrong.get_or_insert_with(|| what.to_owned());
    }
}

/// Runs all checks in order. Fails with [`exit::UNAVAILABLE`] if no valid frames arrive.
pub(crate) fn doctor(args: &DoctorArgs) -> Result<()> {
    let config = args.config.load()?;
    let endpoint = match &args.endpoint {
        Some(endpoint) => endpoint.clone(),
        None => configured(&config)?,
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut report = Report::default();
    runtime.block_on(async {
        look(&endpoint, args.interface.clone(), &config, &mut report).await;
        daemon::look(&endpoint, &config, &mut report).await;
    });
    runtime.shutdown_background(); // do not wait for a control socket that does not answer
    written(io::stdout().write_all(report.text.as_bytes()))?;
    match report.wrong {
        None => Ok(()),
        Some(wrong) => Err(Failure::new(exit::UNAVAILABLE, format!("{endpoint}: {wrong}")).into()),
    }
}

async fn look(endpoint: &Endpoint, interface: Option<String>, config: &Config, report: &mut Report) {
    let options = Options { interface, ..Options::default() };
    let mut client = match timeout(SHORTEST, Client::connect_with(endpoint, options)).await {
        Ok(Ok(client)) => client,
        Ok(Err(error)) => return link::not_open(endpoint, &error, config, report),
        Err(_) => {
            let timed_out = io::Error::from(io::ErrorKind::TimedOut);
            let error = ClientError::Open { endpoint: endpoint.clone(), source: timed_out };
            return link::not_open(endpoint, &error, config, report);
        }
    };
    report.good(match endpoint {
        Endpoint::Tcp(_) => "connected",
        Endpoint::Udp(_) => "the local port is open",
        Endpoint::Subscribe(_) => "subscribed",
    });
    let mut seen = ReceivedFrames::default();
    let expected = match endpoint {
        Endpoint::Udp(place) => link::frame_period(place, config).await,
        _ => None,
    };
    match collect(&mut client, endpoint, Wait::new(expected), &mut seen).await {
        Ok(()) if seen.frames() > 0 => seen.tell(client.losses(), report),
        Ok(()) => link::silent(endpoint, &seen, client.losses(), config, report).await,
        Err(error) => link::broken(&error, report),
    }
}

/// Collects messages until enough frames for the checks have arrived.
async fn collect(
    client: &mut Client,
    endpoint: &Endpoint,
    mut wait: Wait,
    seen: &mut ReceivedFrames,
) -> Result<(), ClientError> {
    let mut utc = Utc::system();
    let mut now_ns = || {
        let now: Mono = SystemClock.now();
        utc.at(now, now).0
    };
    while seen.frames() == 0 {
        match wait.next(client, endpoint).await? {
            Heard::Message(message) => seen.message(message, now_ns()),
            Heard::Silence { due: true, .. } => return Ok(()),
            Heard::Silence { .. } => {}
        }
    }
    let end = Instant::now() + LOOK;
    while let Ok(message) = timeout_at(end, client.next()).await {
        seen.message(message?, now_ns());
    }
    Ok(())
}
