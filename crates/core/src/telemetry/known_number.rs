//! A number that may be unknown, for occasional readers.

use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

/// The bits of the number; NaN while it is unknown.
#[derive(Debug)]
pub struct KnownNumber(AtomicU64);

impl Default for KnownNumber {
    fn default() -> Self {
        Self(AtomicU64::new(f64::NAN.to_bits()))
    }
}

impl KnownNumber {
    /// Records the number.
    pub fn set(&self, number: Option<f64>) {
        self.0.store(number.unwrap_or(f64::NAN).to_bits(), Relaxed);
    }

    /// The number, if it is known.
    pub fn get(&self) -> Option<f64> {
        Some(f64::from_bits(self.0.load(Relaxed))).filter(|number| !number.is_nan())
    }
}
