//! The folder of a run: its files, and what a continued run must have in common with its beginning.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde_json::{Value, json};
use trifacet::calibration::points_writer::{Contents, PointsFile};
use trifacet::config::Config;
use trifacet::exit::{self, Failure};

use super::RunArgs;
use crate::commands::experiment::fresh;
use crate::commands::new_file::NewFile;

/// The points, and what they were measured with.
const POINTS: &str = "points.csv";
const RUN: &str = "run.json";

/// The folder with its open file of points.
pub(super) struct RunFolder {
    path: PathBuf,
    /// The file of the points.
    pub(super) points: PointsFile,
    /// Numbers of the points that it contains.
    pub(super) done: Vec<u32>,
}

impl RunFolder {
    /// An empty folder, or with `--resume` one whose points were measured with the same plan and channels.
    pub(super) fn open(args: &RunArgs, config: &Config) -> anyhow::Result<Self> {
        let path = args.out.clone();
        let now = settings(args, config)?;
        if args.resume && path.join(POINTS).exists() {
            belongs(&path, &now)?;
            let (points, done) = PointsFile::resume(&path.join(POINTS))?;
            return Ok(Self { path, points, done });
        }
        fresh(&path)?;
        NewFile::write(&path.join(RUN), format!("{now:#}\n").as_bytes())?;
        let points = PointsFile::create(&path.join(POINTS), Contents::Points)
            .with_context(|| format!("cannot write {}", path.join(POINTS).display()))?;
        Ok(Self { path, points, done: Vec::new() })
    }

    /// A new file of a scan; `None` if it was written before.
    pub(super) fn scan(&self, name: &str) -> anyhow::Result<Option<PointsFile>> {
        let path = self.path.join(name);
        if path.exists() {
            return Ok(None);
        }
        let file = PointsFile::create(&path, Contents::Scan);
        Ok(Some(file.with_context(|| format!("cannot write {}", path.display()))?))
    }

    /// Removes a scan that was not completed.
    pub(super) fn discard_scan(&self, name: &str) {
        let _ = fs::remove_file(self.path.join(name)); // a fit would miss positions, and --resume repeats it
    }

    /// The file of the points, for messages.
    pub(super) fn file(&self) -> PathBuf {
        self.path.join(POINTS)
    }
}

/// What all points of a file must have in common.
fn settings(args: &RunArgs, config: &Config) -> anyhow::Result<Value> {
    let plan = fs::read(&args.plan).with_context(|| format!("cannot read {}", args.plan.display()))?;
    let channels = config.channels.psds().map(|psd| {
        let [u, v, _] = psd.gain;
        json!({
            "amplifier": psd.amplifier, "full_scale_v": psd.full_scale_v, "gain_uv": [u, v], "dark_v": psd.dark_v,
        })
    });
    Ok(json!({
        "version": env!("CARGO_PKG_VERSION"),
        "plan_crc32": crc32fast::hash(&plan),
        "channels": channels,
        "power_mw_per_v": config.channels.power_mw_per_v,
        "readback_um_per_v": config.channels.readback_um_per_v,
    }))
}

/// Checks that the run in the folder has the same plan and channels.
fn belongs(path: &Path, now: &Value) -> Result<(), Failure> {
    let file = path.join(RUN);
    let text = fs::read_to_string(&file)
        .map_err(|e| Failure::new(exit::IO, format!("cannot read {}: {e}", file.display())))?;
    let before: Value = serde_json::from_str(&text)
        .map_err(|e| Failure::new(exit::DATA, format!("{}: {e}", file.display())))?;
    let keys = ["plan_crc32", "channels", "power_mw_per_v", "readback_um_per_v"];
    match keys.into_iter().find(|key| before[key] != now[key]) {
        None => Ok(()),
        Some(key) => {
            let what = match key {
                "plan_crc32" => "--plan is another file".to_owned(),
                key => format!("{key} of the configuration has changed"),
            };
            let remedy = "use the same as before, or choose a new folder with --out";
            Err(Failure::new(exit::USAGE, format!("{}: {what}: {remedy}", path.display())))
        }
    }
}
