//! `trifacet dark`: measures the dark offsets with the laser off and writes them into the configuration.

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use tokio::time::{Instant, timeout_at};
use trifacet::acquisition::{BoardSource, LabjackSource, Source, SourceEvent};
use trifacet::clock::SystemClock;
use trifacet::config::edit::{self, Edit};
use trifacet::config::{Config, FaultKind, SourceKind};
use trifacet::exit::{self, Failure};
use trifacet::twin::{Twin, TwinSource};
use trifacet_core::channels::dark::{DarkOffsetEstimator, DarkOffsets};
use trifacet_core::telemetry::Counters;
use trifacet_optics::FACETS;

use super::{ConfigArg, within, written};

/// Longest time to wait for the next scan.
const SCAN_TIMEOUT: Duration = Duration::from_secs(5);

/// Options of `dark`.
#[derive(Debug, clap::Args)]
pub(crate) struct DarkArgs {
    #[command(flatten)]
    config: ConfigArg,
    /// Number of scans to average
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = within(10_u32..=1_000_000))]
    samples: u32,
    /// Print the offsets and do not change the file
    #[arg(long)]
    print: bool,
}

/// Measures the offsets and writes them into the file of `--config`. Without a file, prints them.
pub(crate) fn dark(args: &DarkArgs) -> anyhow::Result<()> {
    let config = args.config.load()?;
    let file = args.config.path().filter(|_| !args.print);
    if let Some(file) = file {
        edit::check(file).with_context(|| format!("cannot write into {}", file.display()))?;
    }
    let offsets = measure(&config, args.samples)?;
    report(&offsets);
    match file {
        Some(file) => write(file, &offsets),
        None => written(write!(io::stdout(), "{}", edit::edited("", &edits(&offsets))?)),
    }
}

fn measure(config: &Config, samples: u32) -> anyhow::Result<DarkOffsets> {
    let counters = Arc::new(Counters::default());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    match config.acquisition.source {
        SourceKind::Board | SourceKind::Serial => {
            let source = BoardSource::open(config, SystemClock, counters)?;
            eprintln!("averaging {samples} scans of the board: the laser must be off");
            runtime.block_on(average(source, config, samples))
        }
        SourceKind::Labjack => {
            let source = LabjackSource::new(config, SystemClock, counters);
            eprintln!("averaging {samples} scans of the LabJack T7: the laser must be off");
            runtime.block_on(average(source, config, samples))
        }
        SourceKind::Replay => {
            let why = "acquisition.source = \"replay\": a recording cannot be measured again";
            Err(Failure::new(exit::CONFIG, why).into())
        }
        SourceKind::Twin => {
            let mut twin = Twin::new(config)?;
            twin.inject(FaultKind::BeamBlocked, None)?;
            eprintln!("averaging {samples} scans of the twin with its laser off");
            runtime.block_on(async {
                let silence = config.acquisition.silence_times();
                average(TwinSource::new(twin, SystemClock, counters, silence)?, config, samples).await
            })
        }
    }
}

async fn average(mut source: impl Source, config: &Config, samples: u32) -> anyhow::Result<DarkOffsets> {
    let refuse = |error| Failure::new(exit::DATA, format!("no dark offsets: {error}"));
    let mut darkness = None;
    let mut why = "the source sent no scan".to_owned();
    let mut deadline = Instant::now() + SCAN_TIMEOUT;
    let offsets = loop {
        let Ok(event) = timeout_at(deadline, source.next()).await else {
            return Err(Failure::new(exit::UNAVAILABLE, format!("no dark offsets: {why}")).into());
        };
        match event {
            SourceEvent::Up(identity) => {
                darkness = Some(DarkOffsetEstimator::new(&identity).map_err(refuse)?);
            }
            SourceEvent::Down(down) => why = down.to_string(),
            SourceEvent::Ack(_) => {}
            SourceEvent::Scan(scan) => {
                let Some(darkness) = &mut darkness else { continue };
                deadline = Instant::now() + SCAN_TIMEOUT;
                darkness.push(&scan).map_err(refuse)?;
                if darkness.count() >= samples {
                    break darkness.offsets(config.channels.sum_threshold_v);
                }
            }
        }
    };
    source.close().await;
    Ok(offsets.map_err(refuse)?)
}

/// Prints one line per PSD.
fn report(offsets: &DarkOffsets) {
    for (i, psd) in FACETS.into_iter().enumerate() {
        let [u, v, sum] = offsets.volts[i].map(|volts| volts * 1e3);
        let worst = offsets.sigma[i].into_iter().fold(0.0, f64::max) * 1e3;
        eprintln!("PSD {psd}: u {u:.4} mV, v {v:.4} mV, sum {sum:.4} mV, standard uncertainty {worst:.4} mV");
    }
}

fn write(file: &Path, offsets: &DarkOffsets) -> anyhow::Result<()> {
    edit::write(file, &edits(offsets))
        .with_context(|| format!("cannot write the dark offsets into {}", file.display()))?;
    eprintln!("written to {} as channels.a, .b, .c dark_v", file.display());
    Ok(())
}

fn edits(offsets: &DarkOffsets) -> [Edit; 3] {
    let rounded = offsets.volts.map(|psd| psd.map(|v| (v * 1e7).round() / 1e7)); // to 0.1 uV
    let edit =
        |section, values: [f64; 3]| Edit { section, key: "dark_v", value: values.into_iter().collect() };
    let [a, b, c] = rounded;
    [edit(&["channels", "a"], a), edit(&["channels", "b"], b), edit(&["channels", "c"], c)]
}
