//! Recordings of the free-running twin.

use std::path::PathBuf;

use crate::testkit::{Folder, run, trifacet};

/// A temporary folder with recordings.
pub(crate) struct Lab(pub(crate) Folder);

/// All faults of samples within three seconds at 2 kHz.
pub(crate) const EVENTFUL: &str = "
    acquisition.rate_hz = 2000
    estimation.fuse_steering = true
    [twin]
    channel_skew_us = 20
    steering.readback_noise_um = 0.1
    [[twin.motion]]
    axis = 'tx'
    kind = 'sine'
    amount_um = 200
    frequency_hz = 3
    [[twin.fault]]
    kind = 'stalled'
    at_s = 0.7
    for_s = 0.2
    [[twin.fault]]
    kind = 'beam-blocked'
    at_s = 1.6
    for_s = 0.3
";

impl Lab {
    pub(crate) fn new() -> Self {
        Self(Folder::new())
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path(name)
    }

    pub(crate) fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        self.0.write(name, bytes)
    }

    /// Records this number of scans of the twin with this configuration.
    pub(crate) fn record(&self, name: &str, config: &str, samples: u32) -> PathBuf {
        let config = self.write("lab.toml", config);
        let file = self.path(name);
        let mut command = trifacet(&["simulate", "--closed-loop", "--samples", &samples.to_string()]);
        let done = run(command.arg("--config").arg(config).arg("--record").arg(&file));
        assert_eq!(done.code, 0, "{}", done.err);
        file
    }
}
