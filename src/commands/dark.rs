//! `trifacet dark`: measures the dark offsets with the laser off and writes them into the configuration.

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use tokio::time::{Instant, timeout_at};
use toml_edit::{Array, DocumentMut, Item, Table};
use trifacet::acquisition::dark::{DarkOffsets, Darkness};
use trifacet::acquisition::{Event, SerialSource, Source};
use trifacet::clock::SystemClock;
use trifacet::config::{self, Config, FaultKind, SourceKind};
use trifacet::exit::{self, Failure};
use trifacet::monitor::Counters;
use trifacet::optics::FACETS;
use trifacet::twin::{Twin, TwinSource};

use super::{ConfigArg, written};

/// The longest wait for the next scan.
const PATIENCE: Duration = Duration::from_secs(5);

/// Options of `dark`.
#[derive(Debug, clap::Args)]
pub(crate) struct DarkArgs {
    #[command(flatten)]
    config: ConfigArg,
    /// Scans to average
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u32).range(10..=1_000_000))]
    samples: u32,
    /// Print the offsets and leave the file as it is
    #[arg(long)]
    print: bool,
}

/// Measures, and writes the offsets into the file of `--config`, or to standard output without one.
pub(crate) fn dark(args: &DarkArgs) -> anyhow::Result<()> {
    let config = args.config.load()?;
    let offsets = measure(&config, args.samples)?;
    report(&offsets);
    match args.config.path() {
        Some(file) if !args.print => write(file, &offsets),
        _ => written(write!(io::stdout(), "{}", edited("", &offsets)?)),
    }
}

fn measure(config: &Config, samples: u32) -> anyhow::Result<DarkOffsets> {
    let counters = Arc::new(Counters::default());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    match config.acquisition.source {
        SourceKind::Serial => {
            let source = SerialSource::open(config, SystemClock, counters)?;
            eprintln!("averaging {samples} scans of the board; the laser must be off");
            runtime.block_on(average(source, config, samples))
        }
        SourceKind::Twin => {
            let mut twin = Twin::new(config)?;
            twin.inject(FaultKind::BeamBlocked, None)?;
            eprintln!("averaging {samples} scans of the twin, whose laser is off");
            runtime.block_on(async {
                average(TwinSource::new(twin, SystemClock, counters)?, config, samples).await
            })
        }
    }
}

async fn average(mut source: impl Source, config: &Config, samples: u32) -> anyhow::Result<DarkOffsets> {
    let refuse = |error| Failure::new(exit::DATA, format!("no dark offsets: {error}"));
    let mut darkness = None;
    let mut why = "nothing came from the source".to_owned();
    let mut deadline = Instant::now() + PATIENCE;
    let offsets = loop {
        let Ok(event) = timeout_at(deadline, source.next()).await else {
            return Err(Failure::new(exit::UNAVAILABLE, format!("no dark offsets: {why}")).into());
        };
        match event {
            Event::Up(identity) => darkness = Some(Darkness::new(&identity).map_err(refuse)?),
            Event::Down(down) => why = down.to_string(),
            Event::Ack(_) => {}
            Event::Scan(scan) => {
                let Some(darkness) = &mut darkness else { continue };
                deadline = Instant::now() + PATIENCE;
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

/// A line for each PSD, for people.
fn report(offsets: &DarkOffsets) {
    for (i, psd) in FACETS.into_iter().enumerate() {
        let [u, v, sum] = offsets.volts[i].map(|volts| volts * 1e3);
        let worst = offsets.sigma[i].into_iter().fold(0.0, f64::max) * 1e3;
        eprintln!("PSD {psd}: u {u:.4} mV, v {v:.4} mV, sum {sum:.4} mV, each to {worst:.4} mV");
    }
}

/// Replaces the file in one step: a crash leaves the old one or the new one.
fn write(file: &Path, offsets: &DarkOffsets) -> anyhow::Result<()> {
    let context = || format!("cannot write the dark offsets into {}", file.display());
    let text =
        edited(&std::fs::read_to_string(file).with_context(context)?, offsets).with_context(context)?;
    // The new file must mean what was measured; otherwise the old one stays.
    config::parse(&text, Some(file)).with_context(context)?;
    let target = std::fs::canonicalize(file).with_context(context)?;
    let new = target.with_added_extension("new");
    std::fs::write(&new, text).with_context(context)?;
    std::fs::set_permissions(&new, std::fs::metadata(&target)?.permissions()).with_context(context)?;
    std::fs::rename(&new, &target).with_context(context)?;
    eprintln!("written to {} as channels.a, .b, .c dark_v", file.display());
    Ok(())
}

/// The text of a configuration with these offsets in it; all else stays as it is, comments included.
fn edited(text: &str, offsets: &DarkOffsets) -> anyhow::Result<String> {
    let mut document: DocumentMut = text.parse()?;
    let channels = document.entry("channels").or_insert_with(implicit_table);
    for (psd, volts) in ["a", "b", "c"].into_iter().zip(offsets.volts) {
        let rounded = volts.map(|v| (v * 1e7).round() / 1e7); // a tenth of a microvolt
        let entry = channels.as_table_like_mut().context("[channels] is no table")?.entry(psd);
        let psd = entry.or_insert_with(implicit_table).as_table_like_mut().context("no table")?;
        let old = psd.get("dark_v").and_then(Item::as_value).map(|v| v.decor().clone());
        let mut new = toml_edit::Value::from(rounded.into_iter().collect::<Array>());
        if let Some(decor) = old {
            *new.decor_mut() = decor;
        }
        psd.insert("dark_v", Item::Value(new));
    }
    Ok(document.to_string())
}

/// A table that shows only if it has keys of its own.
fn implicit_table() -> Item {
    let mut table = Table::new();
    table.set_implicit(true);
    Item::Table(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_offsets_change() {
        let volts = [[1e-3, -2e-3, 3e-3], [0.0; 3], [0.25, 0.0, -1.234_567_89e-4]];
        let offsets = DarkOffsets { volts, sigma: [[0.0; 3]; 3] };
        let text =
            "# mine\n[channels.a] # first\ngain = [1.0, 1.0, 1.0]\ndark_v = [0.0, 0.0, 0.0]  # old\n[log]\n";
        let new = edited(text, &offsets).unwrap();
        assert!(new.starts_with("# mine\n[channels.a] # first\ngain = [1.0, 1.0, 1.0]\n"), "{new}");
        assert!(new.contains("dark_v = [0.001, -0.002, 0.003]  # old\n"), "{new}");
        let config = config::parse(&new, None).unwrap();
        assert_eq!(config.channels.c.dark_v, [0.25, 0.0, -1.235e-4]);
        assert_eq!(edited(&new, &offsets).unwrap(), new);
        assert!(config::parse(&edited("", &offsets).unwrap(), None).is_ok());
    }
}
