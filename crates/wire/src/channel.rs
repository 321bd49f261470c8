//! Channels of a converter: what each one measures, and how its codes relate to volts.

use core::fmt;

/// The largest number of channels in a scan.
pub const MAX_CHANNELS: usize = 16;

/// What a channel of the converter measures. The numbers are those of the board protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// First coordinate of PSD 0 (A), 1 (B) or 2 (C): a difference or a normalised position.
    U(u8),
    /// Second coordinate of a PSD.
    V(u8),
    /// Sum signal of a PSD: its power.
    Sum(u8),
    /// Readback of the steering position, axis 0 (x) or 1 (y).
    Steering(u8),
    /// Any other quantity that the board measures, such as a temperature.
    Auxiliary,
}

impl Role {
    /// The number of this role on the wire.
    pub fn number(self) -> u8 {
        match self {
            Role::Auxiliary => 0x00,
            Role::U(psd) => 0x10 + psd,
            Role::V(psd) => 0x20 + psd,
            Role::Sum(psd) => 0x30 + psd,
            Role::Steering(axis) => 0x40 + axis,
        }
    }

    /// The role with this number. An unknown number is [`Role::Auxiliary`]: a channel that is not needed.
    pub fn of(number: u8) -> Self {
        match (number >> 4, number & 0x0f) {
            (1, psd @ 0..=2) => Role::U(psd),
            (2, psd @ 0..=2) => Role::V(psd),
            (3, psd @ 0..=2) => Role::Sum(psd),
            (4, axis @ 0..=1) => Role::Steering(axis),
            _ => Role::Auxiliary,
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let psd = |n: &u8| char::from(b'A' + n);
        match self {
            Role::U(n) => write!(f, "u of PSD {}", psd(n)),
            Role::V(n) => write!(f, "v of PSD {}", psd(n)),
            Role::Sum(n) => write!(f, "the sum of PSD {}", psd(n)),
            Role::Steering(axis) => write!(f, "the steering {}", if *axis == 0 { "x" } else { "y" }),
            Role::Auxiliary => write!(f, "auxiliary"),
        }
    }
}

/// The nine signals of the sensor in their canonical order: u, v, sum of A, then of B, then of C.
pub const SIGNALS: [Role; 9] = [
    Role::U(0),
    Role::V(0),
    Role::Sum(0),
    Role::U(1),
    Role::V(1),
    Role::Sum(1),
    Role::U(2),
    Role::V(2),
    Role::Sum(2),
];

/// How codes relate to volts: two's complement, full scale at `2^(bits-1)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Converter {
    /// Resolution, 8 to 24 bits, sign included.
    pub bits: u8,
    /// Volts at full scale: the range is from `-range_v` to just below `+range_v`.
    pub range_v: f64,
}

impl Converter {
    /// The code of full scale, `2^(bits-1)`. The largest code is one less.
    pub fn full_scale(&self) -> i32 {
        1 << (self.bits - 1)
    }

    /// Volts of one code step.
    pub fn step_v(&self) -> f64 {
        self.range_v / f64::from(self.full_scale())
    }

    /// The code nearest to a voltage, clipped at the rails as a real converter clips. Zero for NaN.
    pub fn code(&self, volts: f64) -> i32 {
        let full = f64::from(self.full_scale());
        round(volts / self.step_v()).clamp(-full, full - 1.0) as i32
    }
}

/// The nearest integer, halves away from zero, as `f64::round`, which `core` lacks.
pub(crate) fn round(x: f64) -> f64 {
    let whole = x as i64 as f64;
    let rest = x - whole;
    if rest >= 0.5 {
        whole + 1.0
    } else if rest <= -0.5 {
        whole - 1.0
    } else {
        whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_that_of_the_standard_library() {
        let cases = [0.5, -0.5, 0.499_999_999_999_999_94, 1.5, -2.5, 8_388_607.5, 1e15 + 0.5, 0.0, -7.2];
        for x in cases {
            assert_eq!(round(x), std::primitive::f64::round(x), "{x}");
        }
        assert_eq!(Converter { bits: 16, range_v: 10.0 }.code(f64::NAN), 0);
        assert_eq!(Converter { bits: 16, range_v: 10.0 }.code(f64::INFINITY), 32767);
    }

    #[test]
    fn every_role_has_a_number_of_its_own() {
        for role in SIGNALS.into_iter().chain([Role::Steering(0), Role::Steering(1), Role::Auxiliary]) {
            assert_eq!(Role::of(role.number()), role);
        }
        assert_eq!(Role::of(0x13), Role::Auxiliary, "there is no fourth PSD");
    }
}
