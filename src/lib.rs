//! # trifacet
//!
//! A laser beam falls on the apex of a three-facet mirror, which splits it onto three position-sensitive
//! detectors (PSDs). This library computes the pose of the mirror from the six spot coordinates and three
//! powers, keeps the beam on the apex, and publishes the results in real time.
//!
//! The data flow through the modules:
//!
//! ```text
//!  twin ─┐                 ┌─> centering ──(command)──> back to the source
//!        ├─> acquisition ──┤       ^ (pose)
//!  board ┘                 └─> estimation ──> publishing ──> UDP, TCP
//! ```
//!
//! - [`twin`], [`acquisition`], [`steering`]: sources of samples, and the stages that steer the laser.
//! - [`centering`], [`estimation`], [`publishing`]: the fast side. The pure cores are in
//!   [`trifacet_core`], the sensor model in [`trifacet_optics`], the byte formats in [`trifacet_wire`].
//! - [`daemon`]: the wiring. [`control`]: commands to the running daemon. [`config`]: the configuration.
//! - [`condition`], [`doubts`], [`grade`], [`monitor`], [`logging`], [`service`]: state of the daemon for operators and supervisors.
//! - [`listening`]: opening of listeners, and their errors.
//! - [`recording`], [`replay`]: records of inputs and results, and their recomputation.
//! - [`text`]: text files and tables from people and spreadsheet programs.
//! - [`budget`]: the uncertainty budget of a pose.
//! - [`identification`]: measurement of the loop. [`experiment`]: the experiment of the paper.
//!
//! Internally, lengths are metres, angles radians, and times nanoseconds of the monotonic clock. Other units
//! are used only in the configuration, where every key carries its unit, and in output for the operator.

pub mod acquisition;
pub mod board_link;
pub mod board_test;
pub mod budget;
pub mod calibration;
pub mod centering;
pub mod charts;
pub mod clock;
pub mod closed_loop_sim;
pub mod condition;
pub mod config;
pub mod control;
pub mod daemon;
pub mod doubts;
pub mod estimation;
pub mod exit;
pub mod experiment;
pub mod grade;
pub mod identification;
pub mod listening;
pub mod logging;
pub mod monitor;
pub mod publishing;
pub mod realtime;
pub mod recording;
pub mod replay;
pub mod serial_port;
pub mod service;
pub mod steering;
pub mod text;
pub mod twin;
pub use trifacet_client as client;
pub use trifacet_core as core;
pub use trifacet_optics as optics;
pub use trifacet_wire as wire;
