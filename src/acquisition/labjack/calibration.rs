//! From the codes of the stream to volts, by the constants in the flash of the device. Pure.

use trifacet_wire::channel::Converter;

use super::registers::f32_at;

/// Largest code of the stream.
const TOP: u16 = u16::MAX;
/// Codes this near to an end are at the end: the part of the range that `channels.clip_limit` leaves by default.
const NEAR: u16 = 33;
/// Volts per code in the range of +-10 V, nominal.
const NOMINAL_SLOPE: f64 = 3.158_058e-4;
/// The code of 0 V, nominal.
const NOMINAL_CENTER: f64 = 33_523.0;
/// Largest deviation of a slope, as a part of the nominal one.
const SLOPE_TOLERANCE: f64 = 0.1;
/// Largest deviation of the code of 0 V.
const CENTER_TOLERANCE: f64 = 1000.0;
/// Number of registers of the constants of one range.
pub const REGISTERS: u16 = 8;
/// Their number of bytes in flash.
pub const BYTES: u32 = 16;

/// The ranges of an input, volts, in the order of their constants in flash.
pub const RANGES_V: [f64; 4] = [10.0, 1.0, 0.1, 0.01];

/// The calibration of the inputs in one range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Volts per code above the centre.
    pub above: f64,
    /// Volts per code below the centre.
    pub below: f64,
    /// The code of 0 V.
    pub center: f64,
}

impl Calibration {
    /// The constants of a range in the registers that were read from flash.
    ///
    /// # Errors
    /// Fails with the reason if the constants cannot be those of a T7.
    pub fn of(registers: &[u16], range_v: f64) -> Result<Self, String> {
        let constant = |place: usize| f64::from(f32_at(registers, 2 * place));
        let [above, below, center] = [constant(0), -constant(1), constant(2)];
        let nominal = NOMINAL_SLOPE * range_v / RANGES_V[0];
        let near = |slope: f64| (slope / nominal - 1.0).abs() <= SLOPE_TOLERANCE;
        if near(above) && near(below) && (center - NOMINAL_CENTER).abs() <= CENTER_TOLERANCE {
            return Ok(Self { above, below, center });
        }
        Err(format!(
            "its calibration constants for +-{range_v} V are not plausible: slopes {above:e} and {below:e} V, centre \
             {center}; nominal are {nominal:e} V and {NOMINAL_CENTER}"
        ))
    }

    /// The converter that delivers the codes of [`Calibration::code`]. Its step is that of the device.
    pub fn converter(&self) -> Converter {
        Converter { bits: 16, range_v: self.above * 32_768.0 }
    }

    /// The code of a sample: 0 at 0 V. The device has no code above about 0.98 of this range; its ends become the
    /// ends of the range, so that a clipped signal is found.
    pub fn code(&self, sample: u16) -> i32 {
        if sample >= TOP - NEAR {
            return i32::from(i16::MAX);
        }
        if sample <= NEAR {
            return i32::from(i16::MIN);
        }
        let above_center = f64::from(sample) - self.center;
        let scale = if above_center < 0.0 { self.below / self.above } else { 1.0 };
        (above_center * scale).round().clamp(f64::from(i16::MIN), f64::from(i16::MAX)) as i32
    }
}

#[cfg(test)]
mod tests {
    use super::super::registers::Value;
    use super::*;

    fn registers(constants: [f32; 4]) -> Vec<u16> {
        constants.into_iter().flat_map(|constant| Value::F32(constant).registers()).collect()
    }

    #[test]
    fn volts_are_those_of_the_constants_in_flash() {
        let flash = registers([3.16e-4, -3.15e-4, 33_500.2, -10.58]);
        let calibration = Calibration::of(&flash, 10.0).unwrap();
        let volts = |sample: u16| f64::from(calibration.code(sample)) * calibration.converter().step_v();
        for (sample, expected) in [
            (33_500, 0.0),
            (43_500, 9999.8 * 3.16e-4),
            (23_500, -10_000.2 * 3.15e-4),
            (60_000, 26_499.8 * 3.16e-4),
        ] {
            assert!((volts(sample) - expected).abs() < 1.6e-4, "{sample}: {} {expected}", volts(sample));
        }
    }

    #[test]
    fn the_ends_of_the_converter_are_the_ends_of_the_range() {
        let calibration = Calibration::of(&registers([3.158e-4, -3.158e-4, 33_523.0, -10.58]), 10.0).unwrap();
        let codes = [0, 20, 65_510, 65_535, 34, 65_000].map(|sample| calibration.code(sample));
        assert_eq!(codes, [-32_768, -32_768, 32_767, 32_767, -32_768, 31_477]);
    }

    #[test]
    fn constants_of_an_erased_flash_are_refused() {
        for constants in
            [[0.0; 4], [f32::NAN; 4], [3.158e-5, -3.158e-5, 33_523.0, 0.0], [3.2e-4, -3.2e-4, 3.0, 0.0]]
        {
            let reason = Calibration::of(&registers(constants), 10.0).unwrap_err();
            assert!(reason.contains("not plausible"), "{reason}");
        }
        assert!(Calibration::of(&registers([3.158e-5, -3.158e-5, 33_523.0, 0.0]), 1.0).is_ok());
        assert!(Calibration::of(&[], 10.0).is_err());
    }
}
