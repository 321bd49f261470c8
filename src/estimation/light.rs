//! Doubts about the light: its power, and what the PSDs read without it.

use trifacet_core::light_checks::{DarkVerdict, LightChecks, PowerVerdict};
use trifacet_core::signals::Sample;
use trifacet_optics::FACETS;

use crate::config::{ChannelsConfig, Config, LaserConfig};
use crate::doubts::{Doubter, Subject};

/// Watches the light of every sample.
#[derive(Debug)]
pub struct LightWatch {
    checks: LightChecks,
    laser: LaserConfig,
    channels: ChannelsConfig,
}

impl LightWatch {
    /// For samples of this configuration.
    pub fn new(config: &Config) -> Self {
        let Config { laser, channels, .. } = config.clone();
        Self { checks: LightChecks::new(laser.reference()), laser, channels }
    }

    /// Another source: its samples do not continue those before.
    pub fn source(&mut self) {
        self.checks = LightChecks::new(self.laser.reference());
    }

    /// Other settings. What they may have removed is judged again.
    pub fn retune(&mut self, config: &Config, doubter: &Doubter) {
        let next = Self::new(config);
        let channels = next.channels != self.channels;
        if channels {
            doubter.end(Subject::AmbientLight);
        }
        if channels || next.laser != self.laser {
            if next.laser.power_uw.is_none() {
                doubter.end(Subject::Power);
            }
            *self = next;
        }
    }

    /// Takes the next sample. Returns the result of a time without light.
    pub fn sample(&mut self, sample: &Sample, doubter: &Doubter) -> Option<DarkVerdict> {
        let (power, dark) = self.checks.push(sample);
        if let Some(verdict) = power {
            let text = verdict.doubted.then(|| self.power(&verdict));
            doubter.set(Subject::Power, sample.time, text);
        }
        if let Some(verdict) = dark {
            let text = verdict.doubted.then(|| ambient(&verdict));
            doubter.set(Subject::AmbientLight, sample.time, text);
        }
        dark
    }

    fn power(&self, PowerVerdict { watts, difference, .. }: &PowerVerdict) -> String {
        format!(
            "the total power is {:.2} uW, {:+.1} % from laser.power_uw, tolerance {} %: laser, dirt, a displaced \
             part, or ambient light",
            watts * 1e6,
            difference * 1e2,
            self.laser.power_tolerance * 1e2
        )
    }
}

fn ambient(DarkVerdict { excess, .. }: &DarkVerdict) -> String {
    let read = FACETS.iter().zip(excess).map(|(psd, part)| format!("{psd} {:.2} %", part * 1e2));
    format!(
        "ambient light: while the laser was off or blocked, the sums read more than their dark offsets, in parts of \
         their usual power: {}. It draws the spots by as much of their distance from the middle. Screen the head; or \
         the offsets have changed: run trifacet dark",
        read.collect::<Vec<_>>().join(", ")
    )
}
