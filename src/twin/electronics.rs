//! From light to codes: detectors, amplifiers, converter. The inverse of the channel map, with the
//! imperfections that the channel map must handle: noise, dark offsets, non-linearity (bow), rails.

use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use trifacet_core::channels::Amplifier;
use trifacet_wire::channel::Converter;

use super::distortion::{Distortion, Ripple};
use super::own_head::PsdErrors;
use super::scene::Spot;
use super::temperature::Temperature;
use crate::config::{Config, PsdChannelsConfig};

/// The random numbers of one scan, in units of the standard deviation. Every scan draws all of them, whether
/// used or not, so that neither faults nor the settings of other parts change the noise of later scans.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    /// For u, v of A, B, C.
    pub spots: [f64; 6],
    /// For the powers of A, B, C.
    pub powers: [f64; 3],
    /// For the readback of the stage.
    pub readback: [f64; 2],
}

impl Noise {
    /// Draws the noise of one scan.
    pub fn draw(rng: &mut impl Rng) -> Self {
        let mut next = |_| rng.sample(StandardNormal);
        let spots = [0; 6].map(&mut next);
        let powers = [0; 3].map(&mut next);
        Self { spots, powers, readback: [0; 2].map(&mut next) }
    }

    /// The noise of the light multiplied by `factor`; the noise of the readback is unchanged.
    #[must_use]
    pub fn louder(self, factor: f64) -> Self {
        let louder = |x| factor * x;
        Self { spots: self.spots.map(louder), powers: self.powers.map(louder), ..self }
    }
}

/// Detectors, amplifiers and converter.
#[derive(Clone, Debug)]
pub struct Electronics {
    converter: Converter,
    psds: [Psd; 3],
    /// Power of the laser, milliwatts.
    laser_mw: f64,
    power_mw_per_v: f64,
    power_noise: f64,
    /// Readback of the stage, metres per volt.
    readback_per_v: f64,
    /// Standard uncertainty of the readback, metres.
    readback_noise: f64,
    temperature: Option<Temperature>,
}

/// A detector with its amplifier.
#[derive(Clone, Debug)]
struct Psd {
    channels: PsdChannelsConfig,
    dark_v: [f64; 3],
    distortion: Distortion,
    /// Standard uncertainty of a spot coordinate, metres.
    noise: f64,
}

impl Electronics {
    /// The electronics of the twin, for PSDs of these half sizes (metres).
    pub fn new(config: &Config, half_sizes: [f64; 3]) -> Self {
        let (twin, channels) = (&config.twin, &config.channels);
        let psds = channels.psds();
        Self {
            converter: Converter { bits: twin.converter_bits, range_v: twin.converter_range_v },
            psds: [0, 1, 2].map(|i| Psd {
                channels: psds[i].clone(),
                dark_v: [0, 1, 2].map(|k| twin.dark_v[3 * i + k]),
                distortion: Distortion {
                    half_size: half_sizes[i],
                    bow: twin.bow_um * 1e-6,
                    asymmetry: [0.0; 6],
                    ripple: [Ripple::default(), Ripple::default()],
                },
                noise: twin.spot_noise_um * 1e-6,
            }),
            laser_mw: twin.laser_mw,
            power_mw_per_v: channels.power_mw_per_v,
            power_noise: twin.power_noise,
            readback_per_v: channels.readback_um_per_v * 1e-6,
            readback_noise: twin.steering.readback_noise_um.unwrap_or(0.0) * 1e-6,
            temperature: None,
        }
    }

    /// The same with PSDs of their own, in place of those that the channel map assumes.
    #[must_use]
    pub fn with_errors(mut self, errors: &[PsdErrors; 3]) -> Self {
        for (psd, errors) in self.psds.iter_mut().zip(errors) {
            psd.channels.gain = errors.gain.map(f64::recip);
            psd.distortion = errors.distortion.clone();
        }
        self
    }

    /// The same with PSDs that drift with the temperature.
    #[must_use]
    pub fn warming(self, temperature: Temperature) -> Self {
        Self { temperature: Some(temperature), ..self }
    }

    /// The converter of all channels.
    pub fn converter(&self) -> Converter {
        self.converter
    }

    /// Power of the whole beam at nominal laser power, watts.
    pub fn laser_w(&self) -> f64 {
        self.laser_mw * 1e-3
    }

    /// The code of one of the nine signals, with the laser at `power` times its nominal power, with `ambient` times a
    /// third of this power on the whole of each PSD, at this temperature after the start.
    pub fn signal(
        &self,
        channel: usize,
        spots: &[Option<Spot>; 3],
        [power, ambient]: [f64; 2],
        noise: &Noise,
        kelvin: f64,
    ) -> i32 {
        let (i, part) = (channel / 3, channel % 3);
        let psd = &self.psds[i];
        let laser_mw = spots[i].map_or(0.0, |s| s.power * power * self.laser_mw);
        let sum_mw = laser_mw + ambient * self.laser_mw / 3.0;
        // The centre of all light; that of the ambient light is the centre of the PSD.
        let share = if ambient > 0.0 { laser_mw / sum_mw } else { 1.0 };
        let spot = spots[i].map(|spot| Spot { at: spot.at.map(|at| at * share), ..spot });
        let sum_v = sum_mw * (1.0 + self.power_noise * noise.powers[i])
            / (self.power_mw_per_v * psd.channels.gain[2]);
        let volts = if part == 2 {
            sum_v
        } else {
            let mut reading = spot.map_or([0.0; 2], |spot| psd.distortion.reading(spot.at));
            if let Some(temperature) = &self.temperature {
                reading = temperature.reading(i, reading, kelvin);
            }
            psd.position(part, reading[part], sum_v, noise.spots[2 * i + part])
        };
        self.converter.code(volts + psd.dark_v[part])
    }

    /// The code of the readback of one axis of the stage, at `position` metres.
    pub fn readback(&self, axis: usize, position: f64, noise: &Noise) -> i32 {
        self.converter.code((position + self.readback_noise * noise.readback[axis]) / self.readback_per_v)
    }

    /// The code of the temperature channel.
    pub fn temperature(&self, kelvin: f64) -> i32 {
        self.converter.code(self.temperature.as_ref().map_or(0.0, |temperature| temperature.volts(kelvin)))
    }

    /// The code of a channel whose amplifier is at its upper rail.
    pub fn rail(&self) -> i32 {
        self.converter.full_scale() - 1
    }
}

impl Psd {
    /// Volts of a position channel, from its reading in metres. Without light, a dividing amplifier outputs its noise about zero; a
    /// difference amplifier outputs zero.
    fn position(&self, axis: usize, reading: f64, sum_v: f64, noise: f64) -> f64 {
        let at = reading + self.noise * noise;
        let unit = match self.channels.amplifier {
            Amplifier::Normalised => self.channels.full_scale_v,
            Amplifier::Difference => sum_v,
        };
        at / self.distortion.half_size * unit / self.channels.gain[axis]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const QUIET: Noise = Noise { spots: [0.0; 6], powers: [0.0; 3], readback: [0.0; 2] };
    const HALF: f64 = 6.5e-3;

    fn volts(config: &Config, channel: usize, spot: Option<Spot>, power: f64) -> f64 {
        let electronics = Electronics::new(config, [HALF; 3]);
        f64::from(electronics.signal(channel, &[spot; 3], [power, 0.0], &QUIET, 0.0))
            * electronics.converter.step_v()
    }

    fn near(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }

    const SPOT: Option<Spot> = Some(Spot { at: [HALF / 2.0, -HALF / 4.0], power: 0.25 });

    #[test]
    fn a_normalised_amplifier_shows_the_position_at_any_power() {
        let mut config = Config::default();
        config.channels.b.gain = [-2.0, 1.0, 0.5];
        config.twin.dark_v = [0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0];
        for power in [1.0, 0.5] {
            near(volts(&config, 0, SPOT, power), 5.0);
            near(volts(&config, 1, SPOT, power), -2.5);
            near(volts(&config, 2, SPOT, power), 0.15 * power / 0.0667);
            near(volts(&config, 3, SPOT, power), -2.5 + 0.1);
            near(volts(&config, 4, SPOT, power), -2.5 + 0.2);
            near(volts(&config, 5, SPOT, power), 0.3 * power / 0.0667 + 0.3);
        }
        for (channel, dark) in [(3, 0.1), (4, 0.2), (5, 0.3)] {
            near(volts(&config, channel, None, 1.0), dark);
        }
    }

    #[test]
    fn a_difference_amplifier_scales_with_the_sum() {
        let mut config = Config::default();
        config.channels.a.amplifier = Amplifier::Difference;
        let sum = volts(&config, 2, SPOT, 0.5);
        near(volts(&config, 0, SPOT, 0.5), 0.5 * sum);
        near(volts(&config, 1, SPOT, 0.5), -0.25 * sum);
    }

    #[test]
    fn codes_are_rounded_and_clipped() {
        let mut config = Config::default();
        config.twin.converter_bits = 12;
        let electronics = Electronics::new(&config, [HALF; 3]);
        let code = |u: f64| {
            electronics.signal(0, &[Some(Spot { at: [u, 0.0], power: 0.3 }); 3], [1.0, 0.0], &QUIET, 0.0)
        };
        assert_eq!([code(HALF), code(-HALF), code(1.1 * HALF)], [2047, -2048, 2047]);
        let step = HALF / 2048.0;
        assert_eq!([code(100.4 * step), code(100.6 * step), code(-0.4 * step)], [100, 101, 0]);
    }

    #[test]
    fn the_bow_is_its_size_at_the_middle_of_an_edge() {
        let mut config = Config::default();
        (config.twin.bow_um, config.twin.converter_range_v) = (100.0, 20.0);
        let off_um = |u: f64, v: f64| {
            let at = [u * HALF, v * HALF];
            (volts(&config, 0, Some(Spot { at, power: 0.3 }), 1.0) / 10.0 - u) * HALF * 1e6
        };
        let close = |a: f64, b: f64| assert!((a - b).abs() < 0.1, "{a} {b}");
        close(off_um(1.0, 0.0), 100.0);
        close(off_um(0.0, 1.0), 0.0);
        close(off_um(-1.0, 1.0), -200.0);
        close(off_um(0.5, 0.0), 12.5);
    }

    #[test]
    fn the_readback_is_in_volts_of_the_stage() {
        let electronics = Electronics::new(&Config::default(), [HALF; 3]);
        near(f64::from(electronics.readback(1, -75e-6, &QUIET)) * electronics.converter.step_v(), -1.5);
    }
}
