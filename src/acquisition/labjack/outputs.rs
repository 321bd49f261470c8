//! The steering outputs: from output codes to volts. Pure.

use super::registers::{DAC, Register, TDAC, Value};
use crate::config::{LabjackConfig, LabjackOutputs};

/// Two outputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outputs {
    /// The register of the first; that of the second follows.
    pub first: Register,
    /// Resolution in bits, sign included.
    pub bits: u8,
    /// Volts at code 0.
    middle_v: f64,
    /// Volts from code 0 to full scale.
    half_span_v: f64,
}

impl Outputs {
    /// The outputs of this configuration.
    pub fn of(config: &LabjackConfig) -> Self {
        match config.outputs {
            LabjackOutputs::Dac => Self { first: DAC, bits: 12, middle_v: 2.5, half_span_v: 2.5 },
            LabjackOutputs::LjtickDac => {
                Self { first: TDAC.at(config.ljtick_dio), bits: 14, middle_v: 0.0, half_span_v: 10.0 }
            }
        }
    }

    /// Code of full scale; the largest code is one less.
    fn full(&self) -> i32 {
        1 << (self.bits - 1)
    }

    /// The voltages for these codes; `None` if a code is out of range.
    pub fn values(&self, codes: [i32; 2]) -> Option<[Value; 2]> {
        let full = self.full();
        let volts = |code: i32| self.middle_v + f64::from(code) / f64::from(full) * self.half_span_v;
        codes
            .iter()
            .all(|code| (-full..full).contains(code))
            .then(|| codes.map(|c| Value::F32(volts(c) as f32)))
    }

    /// The voltages for a position given as a fraction of full scale, which is limited to the range.
    pub fn values_at(&self, parts: [f64; 2]) -> [Value; 2] {
        let full = f64::from(self.full());
        let codes = parts.map(|part| (part * full).round().clamp(-full, full - 1.0) as i32);
        self.values(codes).unwrap_or([Value::F32(self.middle_v as f32); 2])
    }

    /// The position for a voltage, as a fraction of full scale and limited to it.
    pub fn part(&self, volts: f32) -> f64 {
        ((f64::from(volts) - self.middle_v) / self.half_span_v).clamp(-1.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volts(outputs: &Outputs, codes: [i32; 2]) -> Option<[f64; 2]> {
        let volt = |value| if let Value::F32(volts) = value { f64::from(volts) } else { f64::NAN };
        outputs.values(codes).map(|values| values.map(volt))
    }

    #[test]
    fn the_dacs_have_zero_at_half_their_range() {
        let outputs = Outputs::of(&LabjackConfig::default());
        assert_eq!((outputs.first.address, outputs.bits), (1000, 12));
        assert_eq!(volts(&outputs, [0, -2048]), Some([2.5, 0.0]));
        let [_, most] = volts(&outputs, [0, 2047]).unwrap();
        assert!((most - 4.998_78).abs() < 1e-5);
        assert_eq!(volts(&outputs, [2048, 0]), None);
        assert_eq!(volts(&outputs, [0, -2049]), None);
        assert_eq!(outputs.values_at([2.0, -0.5]), outputs.values([2047, -1024]).unwrap());
        assert_eq!([2.5, 5.0, 0.0, 7.0].map(|v| outputs.part(v)), [0.0, 1.0, -1.0, 1.0]);
    }

    #[test]
    fn an_ljtick_dac_has_14_bits_of_10_v_at_its_digital_lines() {
        let config =
            LabjackConfig { outputs: LabjackOutputs::LjtickDac, ljtick_dio: 2, ..LabjackConfig::default() };
        let outputs = Outputs::of(&config);
        assert_eq!((outputs.first.address, outputs.bits), (30_004, 14));
        assert_eq!(volts(&outputs, [-8192, 4096]), Some([-10.0, 5.0]));
    }
}
