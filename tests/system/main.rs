//! The program through its public interfaces: the binary, its files, sockets, terminals, signals, and the
//! page in a browser.
//!
//! There is one test binary, because each one links the whole program. Tests start in the order of their
//! paths, so tests that run at the same time are mostly of one module: the browser does not run beside tests
//! that measure time.

#![allow(clippy::unwrap_used)]

mod testkit;

mod board_network;
mod board_protocol;
mod budget;
mod calibrate_fit;
mod calibrate_run;
mod certificate;
mod command_line;
mod compatibility;
mod configuration;
mod control;
mod daemon;
mod dark;
mod emulate;
mod experiment;
mod kits;
mod labjack;
mod monitor;
mod own_head;
mod page;
mod ports;
mod recording;
mod replay;
mod rewriting;
mod second_opinion;
mod security;
mod self_calibration;
mod serial_board;
mod shipped_files;
mod simulate;
mod soak;
mod stream;
mod tables;
mod tune;
mod uncertainty;
mod workspace;
