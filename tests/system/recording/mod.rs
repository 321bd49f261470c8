//! Recordings of a daemon on its twin, read by independent programs and by trifacet.

mod command;
mod crash;
mod disk;
mod fixture;
mod readers;
mod trigger;
