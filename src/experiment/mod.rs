//! The paper's experiment: each axis moved in small intervals, fifty readings at each point, held against a
//! reference.
//!
//! - [`protocol`]: what is measured where. [`amount`], [`reference`](mod@reference): the interferometer.
//! - [`reading`]: what was read, and its file. [`statistics`], [`rest`], [`allan`](mod@allan), [`fit`]: what it says.
//! - [`twin`], [`live`]: where readings come from.
//! - [`table`], [`report`]: how it is told.

pub mod allan;
pub mod amount;
pub mod fit;
pub mod live;
pub mod protocol;
pub mod reading;
pub mod reference;
pub mod report;
pub mod rest;
pub mod sheet;
pub mod statistics;
pub mod table;
pub mod twin;

/// A number with three digits that count, for people.
pub fn three(x: f64) -> String {
    if !x.is_finite() {
        return "-".into();
    }
    let whole = if x == 0.0 { 1 } else { x.abs().log10().floor() as i32 + 1 };
    format!("{x:.*}", (3 - whole).clamp(0, 9) as usize)
}
