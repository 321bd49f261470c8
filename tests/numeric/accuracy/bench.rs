//! Samples of the twin through the channel map into estimation, without waiting for real time.

use trifacet::config::{CalibrationState, Config};
use trifacet::core::centering::LoopState;
use trifacet::core::channels::Channels;
use trifacet::core::estimation::{Estimation, PoseReport};
use trifacet::core::time::Mono;
use trifacet::twin::{Scene, Twin};

/// A twin followed by estimation; the noise of the twin can be changed.
pub struct Bench {
    estimation: Estimation,
    channels: Channels,
    config: Config,
    index: u64,
}

impl Bench {
    pub fn new(config: &str) -> Self {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), config).unwrap();
        let config = trifacet::config::load(Some(file.path())).unwrap();
        let channels = config.read_channels().unwrap();
        let mut estimation =
            Estimation::new(config.estimation_settings(&CalibrationState::default(), 0).unwrap());
        estimation.source(Twin::new(&config).unwrap().identity().clone().into());
        Self { estimation, channels, config, index: 0 }
    }

    /// The next samples, with `noise` times the configured noise on the spots and powers.
    pub fn take(&mut self, samples: usize, noise: f64) -> Vec<PoseReport> {
        let mut config = self.config.clone();
        config.twin.spot_noise_um *= noise;
        config.twin.power_noise *= noise;
        config.twin.seed += self.index;
        self.run(&config, samples).into_iter().map(|(report, _)| report).collect()
    }

    /// The next samples of the twin as configured, from its start, each with its true state.
    pub fn with_truth(&mut self, samples: usize) -> Vec<(PoseReport, Scene)> {
        self.run(&self.config.clone(), samples)
    }

    fn run(&mut self, config: &Config, samples: usize) -> Vec<(PoseReport, Scene)> {
        let mut twin = Twin::new(config).unwrap();
        let mut map = self.channels.map(twin.identity()).unwrap();
        let mut next = || {
            let scan = twin.next_scan();
            let sample = map.sample(&scan.arrived(Mono(self.index as i64 * 1_000_000), 0).unwrap());
            self.index += 1;
            (self.estimation.sample(&sample, &LoopState::default()).unwrap(), scan.truth)
        };
        (0..samples).map(|_| next()).collect()
    }
}

/// The reported standard uncertainties, um and urad.
pub fn stated(report: &PoseReport) -> [f64; 6] {
    let covariance = report.covariance.unwrap();
    std::array::from_fn(|i| covariance[(i, i)].sqrt() * 1e6)
}
