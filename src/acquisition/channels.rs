//! The channel map: raw codes to spots and powers.

use std::path::Path;

use trifacet_optics::FACETS;
use trifacet_wire::channel::{Converter, MAX_CHANNELS, Role};

use super::correction::{Correction, CorrectionError};
use super::scan::{Identity, PsdState, Sample, Scan};
use crate::config::{Amplifier, Config, PsdChannels, Tables};
use crate::exit::{self, Failure};

/// What is known of the channels before the source has said which is which.
#[derive(Clone, Debug)]
pub struct Channels {
    psds: [PsdMap; 3],
    sum_threshold_v: f64,
    clip_limit: f64,
    watts_per_volt: f64,
    readback_per_volt: f64,
}

/// One PSD with its amplifier.
#[derive(Clone, Debug)]
struct PsdMap {
    channels: PsdChannels,
    half_size: f64,
    correction: Option<Correction>,
}

/// The channel map of a source that has said which channel is which.
#[derive(Clone, Debug)]
pub struct ChannelMap {
    channels: Channels,
    converter: Converter,
    /// Where u, v, sum of each PSD stand in a scan.
    places: [[usize; 3]; 3],
    steering: Option<[usize; 2]>,
    /// Skew of each channel as a fraction of the period.
    skew: [f64; MAX_CHANNELS],
    last: Option<Last>,
}

/// The scan before.
#[derive(Clone, Copy, Debug)]
struct Last {
    scan: Scan,
    volts: [f64; MAX_CHANNELS],
    psds: [PsdState; 3],
}

impl Channels {
    /// Reads what the configuration says of the channels, the correction tables included. Blocks.
    pub fn load(config: &Config) -> Result<Self, Failure> {
        let tables = Tables::read(config).map_err(|e| Failure::new(exit::CONFIG, e.to_string()))?;
        Self::new(config, &tables)
    }

    /// The same with correction tables that were read before.
    pub fn new(config: &Config, tables: &Tables) -> Result<Self, Failure> {
        let mut psds = Vec::new();
        let half_size = config.head.psd_size_mm * 0.5e-3;
        for ((name, channels), table) in FACETS.into_iter().zip(config.channels.psds()).zip(&tables.0) {
            let refuse = |error: CorrectionError| {
                let path = channels.correction.as_deref().unwrap_or(Path::new("?"));
                let what = format!("correction table of PSD {name}, {}: {error}", path.display());
                Failure::new(exit::CONFIG, what)
            };
            let correction =
                table.as_ref().map(|text| Correction::parse(text, half_size).map_err(refuse)).transpose()?;
            psds.push(PsdMap { channels: channels.clone(), half_size, correction });
        }
        let Ok(psds) = <[PsdMap; 3]>::try_from(psds) else { unreachable!("there are three facets") };
        Ok(Self {
            psds,
            sum_threshold_v: config.channels.sum_threshold_v,
            clip_limit: config.channels.clip_limit,
            watts_per_volt: config.channels.power_mw_per_v * 1e-3,
            readback_per_volt: config.channels.readback_um_per_v * 1e-6,
        })
    }

    /// Whether every PSD has a correction table.
    pub fn calibrated(&self) -> bool {
        self.psds.iter().all(|psd| psd.correction.is_some())
    }

    /// The map for a source; the error names the signal that it lacks.
    pub fn map(&self, identity: &Identity) -> Result<ChannelMap, String> {
        let find = |role| identity.roles.iter().position(|r| *r == role);
        let need = |role: Role| find(role).ok_or_else(|| format!("no channel for {role:?}"));
        let mut places = [[0; 3]; 3];
        for (i, place) in (0..).zip(&mut places) {
            *place = [need(Role::U(i))?, need(Role::V(i))?, need(Role::Sum(i))?];
        }
        let mut skew = [0.0; MAX_CHANNELS];
        for (skew, ns) in skew.iter_mut().zip(&identity.skew_ns) {
            *skew = f64::from(*ns) * 1e-9 * identity.rate_hz;
        }
        Ok(ChannelMap {
            channels: self.clone(),
            converter: identity.converter,
            places,
            steering: find(Role::Steering(0)).zip(find(Role::Steering(1))).map(|(x, y)| [x, y]),
            skew,
            last: None,
        })
    }
}

impl ChannelMap {
    /// Goes on with what else is said of the same channels; no scan is interrupted.
    pub fn retune(&mut self, channels: Channels) {
        self.channels = channels;
        if let Some(Last { scan, .. }) = self.last.take() {
            self.follow(&scan);
        }
    }

    /// Takes a scan as the one before the next.
    pub fn follow(&mut self, scan: &Scan) {
        let volts = self.volts(scan);
        let psds = [0, 1, 2].map(|i| self.state(i, scan, &volts));
        self.last = Some(Last { scan: *scan, volts, psds });
    }

    fn volts(&self, scan: &Scan) -> [f64; MAX_CHANNELS] {
        scan.codes.map(|code| f64::from(code) * self.converter.step_v())
    }

    /// The sample of a scan.
    pub fn sample(&mut self, scan: &Scan) -> Sample {
        let last = self.last.filter(|last| last.scan.index + 1 == scan.index);
        self.follow(scan);
        let Some(Last { volts, psds, .. }) = self.last else { unreachable!("it follows the scan") };
        let mut sample = Sample {
            index: scan.index,
            time: scan.time,
            time_sigma_ns: scan.time_sigma_ns,
            lost: scan.lost,
            spots: [f64::NAN; 6],
            powers: [0.0; 3],
            psds,
            steering: None,
            output_railed: scan.output_railed,
        };
        for (i, psd) in self.channels.psds.iter().enumerate() {
            // What was dark or clipped a moment ago says nothing of the light now.
            let last = last.filter(|last| last.psds[i] == PsdState::Good && psds[i] == PsdState::Good);
            let dark = psd.channels.dark_v;
            let [u, v, sum] =
                [0, 1, 2].map(|k| self.at_scan(self.places[i][k], &volts, last.as_ref()) - dark[k]);
            sample.powers[i] = sum * psd.channels.gain[2] * self.channels.watts_per_volt;
            if psds[i] == PsdState::Good {
                [sample.spots[2 * i], sample.spots[2 * i + 1]] = psd.spot([u, v], sum);
            }
        }
        let steering = self.steering.filter(|place| !place.iter().any(|k| self.clipped(scan.codes[*k])));
        sample.steering = steering.map(|place| {
            place.map(|k| self.at_scan(k, &volts, last.as_ref()) * self.channels.readback_per_volt)
        });
        sample
    }

    fn state(&self, psd: usize, scan: &Scan, volts: &[f64; MAX_CHANNELS]) -> PsdState {
        let places = self.places[psd];
        let sum = volts[places[2]] - self.channels.psds[psd].channels.dark_v[2];
        if places.iter().any(|k| self.clipped(scan.codes[*k])) {
            PsdState::Clipped
        } else if sum < self.channels.sum_threshold_v {
            PsdState::Low
        } else {
            PsdState::Good
        }
    }

    /// Volts of a channel at the time of the scan: one that is sampled later is interpolated between
    /// this scan and the last, if there is no gap in between.
    fn at_scan(&self, channel: usize, volts: &[f64; MAX_CHANNELS], last: Option<&Last>) -> f64 {
        let now = volts[channel];
        last.map_or(now, |last| now - self.skew[channel] * (now - last.volts[channel]))
    }

    /// Whether a code is too near to a rail to be believed.
    fn clipped(&self, code: i32) -> bool {
        let largest = self.converter.full_scale() - 1;
        f64::from(code.abs()) >= self.channels.clip_limit * f64::from(largest)
    }
}

impl PsdMap {
    /// The spot in metres, from the volts of u, v and sum.
    fn spot(&self, position: [f64; 2], sum: f64) -> [f64; 2] {
        let unit = match self.channels.amplifier {
            Amplifier::Normalised => self.channels.full_scale_v,
            Amplifier::Difference => sum,
        };
        let spot = [0, 1].map(|k| position[k] * self.channels.gain[k] / unit * self.half_size);
        self.correction.as_ref().map_or(spot, |table| table.apply(spot))
    }
}
