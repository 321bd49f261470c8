//! The rules, in the order in which they are checked.

mod frames;
mod identity;
mod lease;
mod newer;
mod scans;
mod starting;
mod steering;

use super::bench::Bench;
use super::verdict::Broken;

/// A rule of the document.
pub struct Rule {
    /// Its name.
    pub name: &'static str,
    /// The section that contains it.
    pub section: &'static str,
    /// Its check moves the stage.
    pub moves: bool,
    /// Its check depends on the timing of host and line.
    pub timing: bool,
    /// Checks the rule on a stopped board; returns what was seen.
    pub check: Check,
}

type Check = fn(&mut Bench) -> Result<String, Broken>;

const fn rule(name: &'static str, section: &'static str, check: Check) -> Rule {
    Rule { name, section, moves: false, timing: false, check }
}

const fn timed(name: &'static str, section: &'static str, check: Check) -> Rule {
    Rule { timing: true, ..rule(name, section, check) }
}

const fn moving(name: &'static str, section: &'static str, check: Check) -> Rule {
    Rule { moves: true, ..timed(name, section, check) }
}

const IDENTITY: &str = "0x81 IDENTITY";
const FRAMES: &str = "Frames";
const BOARD: &str = "What the board does";
const REPLY: &str = "0x82 REPLY";
const SCAN: &str = "0x84 SCAN";
const LONG_SCAN: &str = "0x86 LONG_SCAN";
const VERSIONS: &str = "Versions";

/// All rules.
pub const ALL: &[Rule] = &[
    rule("identity", "The conversation", identity::answered),
    rule("identity-values", IDENTITY, identity::values),
    rule("boot-id", "0x81 IDENTITY of version 1.1", identity::boot_id),
    rule("versions", VERSIONS, newer::versions),
    rule("silence", BOARD, frames::silence),
    rule("damaged-frames", FRAMES, frames::damaged),
    rule("empty-frames", FRAMES, frames::empty),
    rule("unknown-messages", BOARD, frames::not_understood),
    rule("echo", BOARD, frames::echo),
    rule("steer-stopped", BOARD, steering::stopped),
    rule("start-refused", BOARD, starting::refused),
    rule("start", "The conversation", starting::started),
    rule("start-repeated", BOARD, starting::repeated),
    rule("stop", BOARD, starting::stopped),
    rule("sequence", SCAN, scans::sequence),
    rule("tick", SCAN, scans::tick),
    timed("sample-rate", REPLY, scans::rate),
    rule("scan-values", SCAN, scans::values),
    rule("full-buffer", BOARD, scans::full_buffer),
    rule("steer-refused", BOARD, steering::refused),
    timed("steer-each-scan", BOARD, steering::each_scan),
    rule("long-scan", LONG_SCAN, newer::long_scan),
    moving("steer-accepted", BOARD, steering::accepted),
    moving("steer-range", BOARD, steering::range),
    moving("applied-command", LONG_SCAN, newer::applied),
    moving("lease-expires", BOARD, lease::expires),
    moving("lease-renewed", BOARD, lease::renewed),
    moving("lease-refused", BOARD, lease::refused),
    moving("lease-stop", BOARD, lease::continues),
    moving("lease-parks", BOARD, lease::parks),
];
