//! The rows of a budget: quantities of one kind, with their unit. SI units.

use trifacet_budget::Input;
use trifacet_core::uncertainty::Effect;

/// The unit of a quantity. All are shown in millionths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Shown as um.
    Metre,
    /// Shown as urad.
    Radian,
    /// Shown as ppm.
    One,
}

impl Unit {
    /// The unit of a millionth.
    pub fn micro(self) -> &'static str {
        match self {
            Self::Metre => "um",
            Self::Radian => "urad",
            Self::One => "ppm",
        }
    }
}

/// Quantities of one kind, a row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// The quantity.
    pub name: String,
    /// Where its numbers come from.
    pub source: String,
    /// Unit of all its quantities.
    pub unit: Unit,
    /// The quantities, and what they act on.
    pub inputs: Vec<(Input, Effect)>,
}
