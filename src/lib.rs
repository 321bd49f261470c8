//! # trifacet
//!
//! A laser falls on the apex of a three-facet mirror; each part of the split beam lands on a
//! position-sensitive detector (PSD). This library turns the six spot coordinates and three powers
//! into the mirror's pose, keeps the beam on the apex, and publishes what it knows, in real time.
//!
//! The modules stand in the order in which a sample flows through them:
//!
//! ```text
//!  twin ─┐                 ┌─> centering ──(command)──> back to the source
//!        ├─> acquisition ──┤       ^ (pose)
//!  board ┘                 └─> estimation ──> publishing ──> UDP, TCP
//! ```
//!
//! `optics` is the sensor model that everything rests on; `daemon` is the wiring, `control` changes it
//! while it runs, `tuning` measures its loop, `recording` keeps what went in and came out, `replay` computes it again,
//! `experiment` repeats what the paper measured.
//! Lengths are metres, angles radians, times nanoseconds of the monotonic clock, everywhere inside;
//! other units exist only in the configuration (where every key carries its unit) and on screens.

pub mod acquisition;
pub mod centering;
pub mod charts;
pub mod clock;
pub mod config;
pub mod control;
pub mod daemon;
pub mod estimation;
pub mod exit;
pub mod experiment;
pub mod logging;
pub mod monitor;
pub use {trifacet_optics as optics, trifacet_wire as wire};
pub mod publishing;
pub mod realtime;
pub mod recording;
pub mod replay;
pub mod rig;
pub mod service;
pub mod steering;
pub mod tuning;
pub mod twin;

pub use publishing::client;
