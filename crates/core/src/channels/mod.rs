//! The channel map: raw codes to spots and powers.

use serde::{Deserialize, Serialize};
use trifacet_wire::channel::{MAX_CHANNELS, Role, SIGNALS};

use crate::signals::{Identity, PsdState, Sample, Scan};

pub mod correction;
pub mod dark;
mod frozen;

pub use correction::{Corrected, Correction, CorrectionError};
use frozen::FrozenChannels;

/// The channels of a head, before the source has reported its channel assignment.
#[derive(Clone, Debug)]
pub struct Channels {
    /// The PSDs A, B and C.
    pub psds: [PsdChannels; 3],
    /// Below this sum signal, dark offset subtracted, a PSD gives no position. Volts.
    pub sum_threshold_v: f64,
    /// Codes beyond this fraction of the converter's range count as clipped.
    pub clip_limit: f64,
    /// Power on a PSD per volt of its sum signal.
    pub watts_per_volt: f64,
    /// Position of the stage per volt of its readback signal, metres per volt.
    pub readback_per_volt: f64,
}

/// One PSD with its amplifier.
#[derive(Clone, Debug)]
pub struct PsdChannels {
    /// Output signals of the amplifier.
    pub amplifier: Amplifier,
    /// Output at the edge of the PSD for a normalised amplifier, volts.
    pub full_scale_v: f64,
    /// Gain of u, v and power relative to the nominal gain; a negative value inverts an axis.
    pub gain: [f64; 3],
    /// Readings of u, v and sum with the laser off, volts.
    pub dark_v: [f64; 3],
    /// Half the edge length of the PSD, metres.
    pub half_size: f64,
    /// Correction of its non-linearity, if calibrated.
    pub correction: Option<Correction>,
}

/// Output signals of a PSD amplifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Amplifier {
    /// Positions, already divided by the sum; `full_scale_v` is the edge of the PSD.
    Normalised,
    /// Differences, not divided; a difference equal to the sum is the edge of the PSD.
    Difference,
}

/// The channel map of a source that has reported its channel assignment.
#[derive(Clone, Debug)]
pub struct ChannelMap {
    channels: Channels,
    /// Volts of one step of the converter.
    step_v: f64,
    /// The largest code of the converter.
    largest: i32,
    /// Indices of u, v, sum of each PSD in a scan.
    places: [[usize; 3]; 3],
    steering: Option<[usize; 2]>,
    /// Skew of each channel as a fraction of the sampling period.
    skew: [f64; MAX_CHANNELS],
    last: Option<Last>,
    frozen: FrozenChannels,
}

/// Error: the source does not measure all nine signals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("it has no channel for {0}")]
pub struct MissingSignal(pub Role);

/// The previous scan.
#[derive(Clone, Copy, Debug)]
struct Last {
    index: u64,
    codes: [i32; MAX_CHANNELS],
    psds: [PsdState; 3],
}

/// The nominal board: 10 V amplifiers that divide by the sum, PSDs of 13 mm.
impl Default for Channels {
    fn default() -> Self {
        let psd = PsdChannels {
            amplifier: Amplifier::Normalised,
            full_scale_v: 10.0,
            gain: [1.0; 3],
            dark_v: [0.0; 3],
            half_size: 13.0 * 0.5e-3,
            correction: None,
        };
        Self {
            psds: [psd.clone(), psd.clone(), psd],
            sum_threshold_v: 0.05,
            clip_limit: 0.999,
            watts_per_volt: 0.0667e-3,
            readback_per_volt: 50.0 * 1e-6,
        }
    }
}

impl Channels {
    /// The channels of readings: without correction tables and power gains, which a calibration finds.
    #[must_use]
    pub fn as_read(mut self) -> Self {
        for psd in &mut self.psds {
            (psd.correction, psd.gain[2]) = (None, 1.0);
        }
        self
    }

    /// The map for a source.
    ///
    /// # Errors
    /// The source has no channel for one of the nine signals.
    pub fn map(&self, identity: &Identity) -> Result<ChannelMap, MissingSignal> {
        let need = |role: Role| identity.place(role).ok_or(MissingSignal(role));
        let mut places = [[0; 3]; 3];
        for (i, place) in (0..).zip(&mut places) {
            *place = [need(Role::U(i))?, need(Role::V(i))?, need(Role::Sum(i))?];
        }
        let steering = identity.place(Role::Steering(0)).zip(identity.place(Role::Steering(1)));
        let mut skew = [0.0; MAX_CHANNELS];
        skew.iter_mut().zip(identity.skews()).for_each(|(skew, of_channel)| *skew = of_channel);
        Ok(ChannelMap {
            channels: self.clone(),
            step_v: identity.converter.step_v(),
            largest: identity.converter.full_scale() - 1,
            places,
            steering: steering.map(|(x, y)| [x, y]),
            skew,
            last: None,
            frozen: FrozenChannels::new(),
        })
    }
}

impl ChannelMap {
    /// Continues with other parameters of the same channels, without interrupting the series of scans.
    pub fn retune(&mut self, channels: Channels) {
        self.channels = channels;
        if let Some(Last { index, codes, .. }) = self.last.take() {
            self.last = Some(self.predecessor(index, &codes));
        }
    }

    /// Takes a scan as the predecessor of the next one.
    pub fn follow(&mut self, scan: &Scan) {
        self.last = Some(self.predecessor(scan.index, &scan.codes));
    }

    fn predecessor(&self, index: u64, codes: &[i32; MAX_CHANNELS]) -> Last {
        Last { index, codes: *codes, psds: [0, 1, 2].map(|i| self.state(i, codes)) }
    }

    /// The sample of a scan.
    pub fn sample(&mut self, scan: &Scan) -> Sample {
        let this = self.predecessor(scan.index, &scan.codes);
        let last = self.last.replace(this).filter(|last| last.index + 1 == scan.index);
        let psds = self.without_frozen(scan, this.psds);
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
            applied: scan.applied,
            uncovered: false,
        };
        for (i, psd) in self.channels.psds.iter().enumerate() {
            // A channel that was dark or clipped in the last scan must not enter the interpolation.
            let last =
                last.as_ref().filter(|last| last.psds[i] == PsdState::Good && psds[i] == PsdState::Good);
            let dark = psd.dark_v;
            let [u, v, sum] = [0, 1, 2].map(|k| self.at_scan(self.places[i][k], scan, last) - dark[k]);
            sample.powers[i] = sum * psd.gain[2] * self.channels.watts_per_volt;
            if psds[i] == PsdState::Good {
                let Corrected { spot, covered } = psd.spot([u, v], sum);
                [sample.spots[2 * i], sample.spots[2 * i + 1]] = spot;
                sample.uncovered |= !covered;
            }
        }
        let steering = self.steering.filter(|place| !place.iter().any(|k| self.clipped(scan.codes[*k])));
        sample.steering = steering.map(|place| {
            place.map(|k| self.at_scan(k, scan, last.as_ref()) * self.channels.readback_per_volt)
        });
        sample
    }

    /// The states of the PSDs, with those that have a frozen channel.
    fn without_frozen(&mut self, scan: &Scan, mut psds: [PsdState; 3]) -> [PsdState; 3] {
        if scan.lost > 0 {
            self.frozen.gap();
        }
        let places = self.places.as_flattened();
        let codes = std::array::from_fn(|i| scan.codes[places[i]]);
        let usable = psds.map(|state| state == PsdState::Good);
        if self.frozen.push(codes, usable) {
            for (i, state) in psds.iter_mut().enumerate() {
                if (0..3).any(|k| self.frozen.frozen(3 * i + k)) {
                    *state = PsdState::Frozen;
                }
            }
        }
        psds
    }

    /// The signals whose channels repeat the same code although they have noise.
    pub fn frozen(&self) -> impl Iterator<Item = Role> {
        SIGNALS.into_iter().enumerate().filter(|(i, _)| self.frozen.frozen(*i)).map(|(_, role)| role)
    }

    fn state(&self, psd: usize, codes: &[i32; MAX_CHANNELS]) -> PsdState {
        let places = self.places[psd];
        let sum = self.volts(codes[places[2]]) - self.channels.psds[psd].dark_v[2];
        if places.iter().any(|k| self.clipped(codes[*k])) {
            PsdState::Clipped
        } else if sum < self.channels.sum_threshold_v {
            PsdState::Low
        } else {
            PsdState::Good
        }
    }

    /// Volts of a channel at the time of the scan. A channel that is sampled later is interpolated between
    /// the last scan and this one, unless there is a gap in between.
    fn at_scan(&self, channel: usize, scan: &Scan, last: Option<&Last>) -> f64 {
        let now = self.volts(scan.codes[channel]);
        match (self.skew[channel], last) {
            (0.0, _) | (_, None) => now,
            (skew, Some(last)) => now - skew * (now - self.volts(last.codes[channel])),
        }
    }

    fn volts(&self, code: i32) -> f64 {
        f64::from(code) * self.step_v
    }

    /// Whether a code is at or near a rail of the converter.
    fn clipped(&self, code: i32) -> bool {
        f64::from(code.abs()) >= self.channels.clip_limit * f64::from(self.largest)
    }
}

impl PsdChannels {
    /// The spot, from the volts of u, v and sum.
    fn spot(&self, position: [f64; 2], sum: f64) -> Corrected {
        let unit = match self.amplifier {
            Amplifier::Normalised => self.full_scale_v,
            Amplifier::Difference => sum,
        };
        self.corrected([0, 1].map(|k| position[k] * self.gain[k] / unit * self.half_size))
    }

    /// The spot for a reading in metres. Without a table it is the reading, and counts as covered.
    pub fn corrected(&self, reading: [f64; 2]) -> Corrected {
        let as_read = Corrected { spot: reading, covered: true };
        self.correction.as_ref().map_or(as_read, |table| table.apply(reading))
    }
}
