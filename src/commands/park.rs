//! `trifacet park`: moves the stage to its parking position without a daemon, for example after a crash.

use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use tokio::sync::watch;
use tokio::time::timeout;
use trifacet::acquisition::{BoardSource, LabjackSource, Source, SourceEvent};
use trifacet::clock::SystemClock;
use trifacet::config::{Config, SourceKind};
use trifacet::control;
use trifacet::exit::{self, Failure};
use trifacet::steering::{self, Driver, Stage, StageDriver, StageEvent, StageTask};
use trifacet_core::centering::OnExit;
use trifacet_core::steering::{Command, StagePosition, codes};
use trifacet_core::telemetry::Counters;
use trifacet_core::time::Clock;
use trifacet_wire::actuator::{LeaseAction, OutputCommand};

use super::ConfigArg;

/// Longest time for the whole command.
const PARK_TIMEOUT: Duration = Duration::from_secs(5);

/// Options of `park`.
#[derive(Debug, Args)]
pub(crate) struct ParkArgs {
    #[command(flatten)]
    config: ConfigArg,
    /// Park only if the configuration parks at the end (`steering.on_exit = "park"`); for supervisors
    #[arg(long)]
    as_configured: bool,
}

/// Parks the stage and waits for the acknowledgement. Fails with [`exit::IN_USE`] while a daemon uses the
/// stage.
pub(crate) fn park(args: &ParkArgs) -> anyhow::Result<()> {
    let config = args.config.load()?;
    let steering = &config.steering;
    if args.as_configured && steering.on_exit == OnExit::Hold {
        eprintln!("the stage is not parked: steering.on_exit is \"hold\"");
        return Ok(());
    }
    if let Some(socket) = &config.control.socket
        && control::client::ask(socket, &control::Command::Status).is_ok()
    {
        let why = format!("a daemon listens on {}: use `trifacet ctl park`", socket.display());
        return Err(Failure::new(exit::IN_USE, why).into());
    }
    // The port of the board is kept open until the end, even if the stage has its own controller. No daemon
    // can start in that time.
    let counters = Arc::new(Counters::default());
    let parked = match config.acquisition.source {
        SourceKind::Board | SourceKind::Serial => {
            parking(Some(BoardSource::open(&config, SystemClock, Arc::clone(&counters))?), &config, &counters)
        }
        SourceKind::Labjack => {
            parking(Some(LabjackSource::new(&config, SystemClock, Arc::clone(&counters))), &config, &counters)
        }
        SourceKind::Twin | SourceKind::Replay => {
            parking(None::<BoardSource<SystemClock>>, &config, &counters)
        }
    };
    match parked? {
        None => {
            eprintln!(
                "the stage is not parked: with the twin or a recording, there is no stage without the daemon"
            );
        }
        Some(at) => eprintln!("parked at {at:?} um"),
    }
    Ok(())
}

/// Parks the configured stage; `None` if there is none without the daemon.
fn parking(
    source: Option<impl Source>,
    config: &Config,
    counters: &Counters,
) -> anyhow::Result<Option<[f64; 2]>> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    // The limits do not change in the meantime, so the sender can be dropped.
    let limits = watch::channel(config.steering.clone()).1;
    let Stage { driver, task, .. } = steering::configured(config, limits)?;
    let parked = runtime.block_on(async {
        match (task, source) {
            (Some(task), _held) => stage(driver, task, config, counters).await.map(Some),
            (None, Some(source)) => outputs(source, config).await.map(Some),
            (None, None) => Ok(None),
        }
    });
    runtime.shutdown_background(); // do not wait for a port that is still being opened
    Ok(parked?)
}

/// Parks with the outputs of the board.
async fn outputs(mut source: impl Source, config: &Config) -> Result<[f64; 2], Failure> {
    let steering = &config.steering;
    let position = steering.park_um.map(|um| um * 1e-6);
    let mut why = "the board does not answer".to_owned();
    let parked = timeout(PARK_TIMEOUT, async {
        let (mut bits, mut sent) = (None, false);
        loop {
            match source.next().await {
                SourceEvent::Up(identity) => (bits, sent) = (Some(identity.output_bits), false),
                SourceEvent::Down(down) => why = down.to_string(),
                // The first scan shows that the board has started and accepts commands.
                SourceEvent::Scan(_) if !sent => {
                    let Some(bits) = bits else { continue };
                    let codes = codes(StagePosition(position), steering.full_scale_um * 1e-6, bits);
                    let lease_ms = steering.lease_ms;
                    let command = OutputCommand { id: 1, codes, lease_ms, on_expiry: LeaseAction::Hold };
                    source.steer(command, SystemClock.now());
                    (why, sent) = ("the board does not acknowledge".into(), true);
                }
                SourceEvent::Scan(_) => {}
                SourceEvent::Ack(ack) => return ack.accepted,
            }
        }
    })
    .await;
    source.close().await;
    answered(parked.ok(), &why, steering.park_um)
}

/// Parks a stage that has its own controller.
async fn stage(
    mut driver: StageDriver,
    task: StageTask,
    config: &Config,
    counters: &Counters,
) -> Result<[f64; 2], Failure> {
    let position = config.steering.park_um.map(|um| um * 1e-6);
    let command = Command {
        id: 1,
        position: StagePosition(position),
        lease_ms: config.steering.lease_ms,
        on_expiry: LeaseAction::Hold,
    };
    let mut why = "the controller does not answer".to_owned();
    let talk = async {
        loop {
            match driver.next().await {
                StageEvent::Up => driver.steer(command),
                StageEvent::Ack(ack) => return ack.accepted,
                StageEvent::Down(reason) => why = reason,
                StageEvent::At(_) => {}
            }
        }
    };
    let parked = tokio::select! {
        parked = timeout(PARK_TIMEOUT, talk) => parked.ok(),
        () = task.run(counters) => None,
    };
    answered(parked, &why, config.steering.park_um)
}

fn answered(accepted: Option<bool>, why: &str, park_um: [f64; 2]) -> Result<[f64; 2], Failure> {
    let failed = |why: &str| Err(Failure::new(exit::UNAVAILABLE, format!("not parked: {why}")));
    match accepted {
        Some(true) => Ok(park_um),
        Some(false) => failed("the stage refuses the parking position"),
        None => failed(why),
    }
}
