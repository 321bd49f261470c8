//! `trifacet calibrate report`: the certificate of a calibration.

use std::fmt::Write as _;
use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::ValueEnum;
use sha2::{Digest as _, Sha256};
use trifacet::calibration::Record;
use trifacet::calibration::certificate::{Certificate, IssuedFile, Laboratory, TEMPLATE};
use trifacet::config::{self, RecordError, SourceKind, Tables, fingerprint};
use trifacet::exit::{self, Failure};

use crate::commands::new_file::NewFile;
use crate::commands::{translated, written};

/// Options of `calibrate report`.
#[derive(Debug, clap::Args)]
pub(crate) struct ReportArgs {
    /// Folder with the results of `calibrate fit`
    #[arg(value_name = "DIR", required_unless_present = "laboratory_template")]
    folder: Option<PathBuf>,
    /// Write the certificate of the calibration; without it, the verdict of the fit is printed
    #[arg(long, requires = "out")]
    certificate: bool,
    /// What only the laboratory knows, as TOML
    #[arg(long, value_name = "FILE.toml", requires = "certificate")]
    laboratory: Option<PathBuf>,
    /// Format of the certificate: a page that prints, or a Digital Calibration Certificate 3.3 as XML
    #[arg(long, value_enum, default_value_t = Format::Html, requires = "certificate")]
    format: Format,
    /// File for the certificate
    #[arg(long, value_name = "FILE", requires = "certificate")]
    out: Option<PathBuf>,
    /// Mark what is missing instead of refusing the certificate; DRAFT is printed across each page
    #[arg(long, requires = "certificate")]
    draft: bool,
    /// Print a commented file for --laboratory
    #[arg(long, exclusive = true)]
    laboratory_template: bool,
}

/// Format of a certificate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Html,
    Dcc,
}

/// Writes the certificate, or prints the verdict of the fit.
pub(crate) fn report(args: &ReportArgs) -> anyhow::Result<()> {
    if args.laboratory_template {
        return written(write!(io::stdout(), "{TEMPLATE}"));
    }
    let folder = args.folder.as_deref().unwrap_or(Path::new("."));
    let record = record(folder)?;
    match &args.out {
        Some(out) if args.certificate => certificate(args, folder, &record, out),
        _ => verdict(folder, &record),
    }
}

fn verdict(folder: &Path, record: &Record) -> anyhow::Result<()> {
    let mut text = String::new();
    let report = &record.measurement;
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{}", report["verdict"].as_str().unwrap_or("the record has no verdict"));
    for warning in report["warnings"].as_array().into_iter().flatten().filter_map(|w| w.as_str()) {
        let _ = writeln!(text, "warning: {warning}");
    }
    let _ = writeln!(
        text,
        "{} of {}, more in {}",
        record.header.method,
        record.header.date,
        folder.join("report.html").display()
    );
    written(write!(io::stdout(), "{text}"))
}

const RECORD: &str = "calibration.json";
const CONFIG: &str = "trifacet.toml";

fn refused(why: &str) -> Failure {
    Failure::new(exit::DATA, format!("no certificate, nothing was written: {why}"))
}

fn record(folder: &Path) -> anyhow::Result<Record> {
    let path = folder.join(RECORD);
    match Record::open(&path) {
        Err(RecordError::Unreadable(error)) => {
            Err(error).with_context(|| format!("cannot read {}", path.display()))
        }
        read => Ok(read.map_err(|e| Failure::new(exit::DATA, format!("{}: {e}", path.display())))?),
    }
}

fn certificate(args: &ReportArgs, folder: &Path, record: &Record, out: &Path) -> anyhow::Result<()> {
    let laboratory = match &args.laboratory {
        None => Laboratory::default(),
        Some(path) => {
            let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
            Laboratory::parse(&text)
                .map_err(|why| Failure::new(exit::CONFIG, format!("{}: {why}", path.display())))?
        }
    };
    if args.draft && args.format == Format::Dcc {
        let why = "--draft requires --format html: a Digital Calibration Certificate has no drafts";
        return Err(Failure::new(exit::USAGE, why).into());
    }
    let (files, simulated) = issued_files(folder, record)?;
    if !args.draft {
        if simulated {
            return Err(refused(&format!(
                "acquisition.source = \"twin\" in {}: a simulated head has no certificate; --draft shows what the \
                 certificate of a real one looks like",
                folder.join(CONFIG).display()
            ))
            .into());
        }
        let missing = laboratory.missing();
        if !missing.is_empty() {
            return Err(refused(&format!(
                "not stated: {}. State them in the file of --laboratory (trifacet calibrate report \
                 --laboratory-template prints it), or use --draft, which marks them",
                missing.join(", ")
            ))
            .into());
        }
    }
    let certificate =
        Certificate::new(record, laboratory, files, args.draft).map_err(|e| refused(&e.to_string()))?;
    let text = match args.format {
        Format::Html => certificate.html(),
        Format::Dcc => certificate.dcc().context("the certificate is incomplete")?,
    };
    NewFile::write(out, text.as_bytes())?;
    written(writeln!(io::stdout(), "written to {}", out.display()))
}

/// Configuration, tables and record with their hashes, and whether the source is simulated. The configuration must
/// be the one that the record belongs to.
fn issued_files(folder: &Path, record: &Record) -> anyhow::Result<(Vec<IssuedFile>, bool)> {
    let path = folder.join(CONFIG);
    let config = translated(config::load(Some(&path))?)?;
    let tables = Tables::read(&config)?;
    if fingerprint(&config, &config.channels(&tables)?) != record.header.fits {
        return Err(refused(&format!(
            "{} or its correction tables were changed since the calibration: {RECORD} belongs to other ones",
            path.display()
        ))
        .into());
    }
    let mut names = vec![path, folder.join(RECORD)];
    names.extend(config.channels.psds().into_iter().filter_map(|psd| psd.correction.clone()));
    let mut files = Vec::new();
    for path in names {
        let bytes = fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        files.push(IssuedFile { name, sha256: format!("{:x}", Sha256::digest(&bytes)) });
    }
    Ok((files, config.acquisition.source == SourceKind::Twin))
}
