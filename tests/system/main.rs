//! The program through its front door: the real binary, its files, sockets, terminals, signals, and the page
//! in a real browser.
//!
//! One binary, because each costs a link of the whole program. Tests start in the order of their paths, so those
//! that run at the same time are mostly of the same module: the browser is not beside tests that measure time.

#![allow(clippy::unwrap_used)]

mod testkit;

mod board_protocol;
mod command_line;
mod compatibility;
mod configuration;
mod control;
mod daemon;
mod dark;
mod emulate;
mod experiment;
mod kits;
mod monitor;
mod page;
mod recording;
mod replay;
mod serial_board;
mod shipped_files;
mod simulate;
mod stream;
mod tables;
mod tune;
mod workspace;
