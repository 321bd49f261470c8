//! Compares a replay with the bare solver on the same samples, in one run:
//! `cargo bench --bench replay [-- SECONDS]`.
//!
//! The free-running twin records SECONDS (default 600) at 10 kHz. The bare loop has the samples in memory.
//! For each sample it computes only the pose and its standard uncertainties. The replay reads the file,
//! maps the codes, estimates, and compares every frame. Both run alternately, three times; the medians are
//! printed.

use std::path::Path;
use std::process::Command;

use trifacet::clock::SystemClock;
use trifacet::config::Config;
use trifacet::core::time::Clock;
use trifacet::recording::reader::{Read, Reader};
use trifacet::recording::{Entry, Topic};
use trifacet::replay::read_ahead::{self, News};
use trifacet::replay::{Comparison, Engine};
use trifacet_optics::{Estimator, Noise, Optics, Signals, Solution};

fn main() {
    let seconds = std::env::args().filter(|arg| arg != "--bench").nth(1);
    let seconds: u64 = seconds.map_or(600, |s| s.parse().expect("a number of seconds"));
    let place = tempfile::tempdir().expect("a place");
    let (config, file) = (place.path().join("bench.toml"), place.path().join("bench.mcap"));
    std::fs::write(&config, "acquisition.rate_hz = 10000\n").expect("a file");
    let mut record = Command::new(env!("CARGO_BIN_EXE_trifacet"));
    record.args(["simulate", "--closed-loop", "--samples", &(seconds * 10_000).to_string(), "--config"]);
    assert!(record.arg(&config).arg("--record").arg(&file).status().expect("trifacet").success());
    // Data that are not yet on the disk would slow down one of the two.
    std::fs::File::open(&file).and_then(|file| file.sync_all()).expect("a disk");
    let samples = samples(&file);
    let mut times = [Vec::new(), Vec::new()];
    for _ in 0..3 {
        times[0].push(timed(|| bare(&samples)));
        times[1].push(timed(|| replay(&file, samples.len())));
    }
    let [bare, replay] = times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        times[1]
    });
    let per = |s: f64| s * 1e6 / samples.len() as f64;
    println!("{} samples, {seconds} s at 10 kHz", samples.len());
    println!("bare solver  {bare:8.3} s  {:.3} us a sample", per(bare));
    println!(
        "replay       {replay:8.3} s  {:.3} us a sample, {:.0} times as fast as recorded",
        per(replay),
        seconds as f64 / replay
    );
    println!("ratio        {:8.3}", replay / bare);
}

fn timed(work: impl FnOnce()) -> f64 {
    let start = SystemClock.now();
    work();
    SystemClock.now().seconds_since(start)
}

fn samples(file: &Path) -> Vec<Signals> {
    let mut reader = Reader::open(file, &[Topic::Sample]).expect("a recording");
    let next = || reader.read().expect("it can be read");
    let signals = |read| match read {
        Read::Entry(Entry::Sample { sample, .. }) => {
            Some(Signals { spots: sample.spots, powers: sample.powers })
        }
        _ => None,
    };
    std::iter::from_fn(next).filter_map(signals).collect()
}

fn bare(samples: &[Signals]) {
    let config = Config::default();
    let optics = Optics::new(&config.head.build().expect("the head"));
    let estimator = Estimator::new(optics, config.estimation.model.into());
    let (spot, power) = (config.estimation.spot_noise_um * 1e-6, config.estimation.power_noise);
    let mut warm: Option<Solution> = None;
    for signals in samples {
        let solution = estimator.solve(signals, warm.as_ref()).expect("a pose");
        let noise = Noise { spots: [spot; 6], powers: signals.powers.map(|p| p * power) };
        let covariance =
            estimator.sensitivity(&solution).expect("uncertainties").spread(&noise).pose_covariance();
        std::hint::black_box(covariance.diagonal().map(f64::sqrt));
        warm = Some(solution);
    }
}

fn replay(file: &Path, samples: usize) {
    let (mut engine, mut comparison) = (Engine::new(), Comparison::default());
    for news in read_ahead::read(vec![file.to_owned()]) {
        let News::Read(reads, _) = news else { continue };
        for read in &reads {
            let Read::Entry(entry) = read else { panic!("{read:?}") };
            engine.take(entry).expect("the recorded configuration");
            comparison.take(entry, engine.report());
        }
    }
    assert_eq!((comparison.same, comparison.other), (samples as u64, 0));
}
