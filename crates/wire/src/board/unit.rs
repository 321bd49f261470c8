//! What the codes of a channel that carries no signal of the sensor mean.

use core::fmt;

use super::error::MessageError;
use super::fields::{Reader, Writer};

/// The largest number of such channels in an identity.
pub const MAX_UNITS: usize = 7;

macro_rules! units {
    ($($(#[$doc:meta])* $variant:ident = $number:literal, $symbol:literal;)*) => {
        /// A unit of measurement. The numbers are those of the board protocol.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Unit {
            $($(#[$doc])* $variant,)*
            /// A unit that this program does not know.
            Other(u8),
        }

        impl Unit {
            /// The number of this unit on the wire.
            pub fn number(self) -> u8 {
                match self { $(Self::$variant => $number,)* Self::Other(number) => number }
            }

            /// The unit with this number.
            pub fn of(number: u8) -> Self {
                match number { $($number => Self::$variant,)* other => Self::Other(other) }
            }
        }

        impl fmt::Display for Unit {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self { $(Self::$variant => f.write_str($symbol),)* Self::Other(n) => write!(f, "unit {n}") }
            }
        }
    };
}

units! {
    /// A number without a unit.
    One = 0, "1";
    /// Volt.
    Volt = 1, "V";
    /// Ampere.
    Ampere = 2, "A";
    /// Degree Celsius.
    Celsius = 3, "degC";
    /// Pascal.
    Pascal = 4, "Pa";
    /// Percent.
    Percent = 5, "%";
    /// Watt.
    Watt = 6, "W";
    /// Metre.
    Metre = 7, "m";
    /// Metre per second squared.
    Acceleration = 8, "m/s2";
    /// Hertz.
    Hertz = 9, "Hz";
}

/// The meaning of the codes of one channel: value = (code - zero) * scale * 10^exponent, in this unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChannelUnit {
    /// Index of the channel, in the order of the identity.
    pub channel: u8,
    /// The unit.
    pub unit: Unit,
    /// Factor of a code.
    pub scale: i32,
    /// Power of ten of the factor.
    pub exponent: i8,
    /// Code at which the value is zero, 24 bits.
    pub zero: i32,
}

impl ChannelUnit {
    /// The value of a code, in this unit.
    pub fn value(&self, code: i32) -> f64 {
        let mut value = f64::from(code - self.zero) * f64::from(self.scale);
        for _ in 0..self.exponent.unsigned_abs() {
            value = if self.exponent < 0 { value / 10.0 } else { value * 10.0 };
        }
        value
    }

    pub(super) fn write(&self, message: Writer) -> Writer {
        message.u8(self.channel).u8(self.unit.number()).i32(self.scale).i8(self.exponent).i24(self.zero)
    }

    pub(super) fn read(body: &mut Reader) -> Result<Self, MessageError> {
        Ok(Self {
            channel: body.u8()?,
            unit: Unit::of(body.u8()?),
            scale: body.i32()?,
            exponent: body.i8()?,
            zero: body.i24()?,
        })
    }
}
