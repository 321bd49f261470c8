//! Recordings, made by the real daemon on its twin, read by programs that know nothing of it and by ours.

mod command;
mod crash;
mod disk;
mod fixture;
mod readers;
mod trigger;
