//! Time. Every moment is a [`Mono`]: nanoseconds of `CLOCK_MONOTONIC`, which never steps. UTC is used only
//! for output, through one slewed offset ([`crate::utc`]).
//!
//! Code that needs the present time takes a [`Clock`].

use std::ops::{Add, Sub};

use serde::{Deserialize, Serialize};

/// Nanoseconds in a second.
pub const NS_PER_S: i64 = 1_000_000_000;

/// A moment: nanoseconds of the monotonic clock. Only differences have a meaning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Mono(pub i64);

impl Mono {
    /// The time from `earlier` to this moment in seconds; negative if `earlier` is later.
    pub fn seconds_since(self, earlier: Mono) -> f64 {
        (self.0 - earlier.0) as f64 / NS_PER_S as f64
    }
}

/// A moment this many nanoseconds later.
impl Add<i64> for Mono {
    type Output = Mono;
    fn add(self, ns: i64) -> Mono {
        Mono(self.0 + ns)
    }
}

/// The nanoseconds between two moments.
impl Sub for Mono {
    type Output = i64;
    fn sub(self, earlier: Mono) -> i64 {
        self.0 - earlier.0
    }
}

/// A source of the present time. Injected, so that tests control the time.
pub trait Clock: Clone + Send + Sync + 'static {
    /// The present moment.
    fn now(&self) -> Mono;
}
