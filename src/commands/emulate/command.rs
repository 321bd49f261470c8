//! Commands on standard input of the emulated board, one per line.

use std::str::FromStr;

use trifacet::config::{Fault, FaultKind};
use trifacet::twin::MirrorMove;
use trifacet::twin::moves::DEFAULT_S;

/// The commands, as `--help` lists them.
pub(super) const HELP: &str = "\
Prints the path of the port, or the address or socket at which it listens, and runs until SIGTERM or SIGINT. Commands are read from standard input, one per line.
S is a duration in seconds; without S, a fault is permanent:
  beam-blocked [S]          no light at all
  psd-dark 0..2 [S]         a PSD sees no light
  clipped 0..8 [S]          a channel reads the limit of its range
  frozen 0..8 [S]           a channel repeats its last code
  readback-frozen [S]       the readback of the stage repeats its last codes
  clock-rate FACTOR [S]     the clock of the board runs at this multiple of its rate
  dropped 0..1 [S]          this fraction of the scans is not sent
  corrupted 0..1 [S]        this fraction of the scans is damaged in transit
  stalled [S]               the board stops sending
  bursts MS [S]             the board sends every MS milliseconds only, all at once
  mute-acks [S]             the board executes commands, but acknowledges none
  wrong-acks [S]            the board executes commands, but acknowledges other ids
  steering-stuck [S]        the stage ignores commands
  laser-power FACTOR [S]    the power of the laser is multiplied
  flicker 0..1 HZ [S]       the power of the laser changes as a sine with this amplitude and frequency
  ambient-light 0..1 [S]    other light on each PSD, as a fraction of a third of the laser's power
  noise-burst FACTOR [S]    the noise of spots and powers is multiplied
  laser-bump X Y [S]        the laser is displaced by X, Y micrometres; the readback does not change
  unplug S                  the port disappears for S seconds
  restart                   the board restarts: it stops, its outputs go to code 0, its clock begins anew
  pose TX TY TZ ROLL PITCH YAW [S]
                            the mirror moves there within S seconds (default 1) and stays; micrometres and
                            microradians
  status                    prints the state of the board, one line of JSON";

/// The same list for error messages.
const ALLOWED: &str = "allowed are: beam-blocked [S], psd-dark 0..2 [S], clipped 0..8 [S], frozen 0..8 [S], readback-frozen [S], \
    clock-rate FACTOR [S], dropped 0..1 [S], \
    corrupted 0..1 [S], stalled [S], bursts MS [S], mute-acks [S], wrong-acks [S], steering-stuck [S], laser-power FACTOR [S], \
     flicker 0..1 HZ [S], ambient-light 0..1 [S], noise-burst FACTOR [S], laser-bump X Y [S], unplug S, restart, \
     pose TX TY TZ ROLL PITCH YAW [S], status (S: duration in seconds)";

/// Longest duration, seconds. A longer fault can be permanent.
const LONGEST_S: f64 = 1e6;

/// A parsed command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum EmulatorCommand {
    /// Simulate a fault. `for_s`: duration, seconds; `None`: permanent.
    Fault { kind: FaultKind, for_s: Option<f64> },
    /// Unplug the cable. `for_s`: duration, seconds.
    Unplug { for_s: f64 },
    /// Restart the board.
    Restart,
    /// Move the mirror.
    Pose(MirrorMove),
    /// Print the state of the board.
    Status,
}

/// A line that is not a command.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("not a command: `{line}`; {ALLOWED}")]
pub(super) struct UnknownCommand {
    line: String,
}

impl FromStr for EmulatorCommand {
    type Err = UnknownCommand;

    fn from_str(line: &str) -> Result<Self, UnknownCommand> {
        let mut words = line.split_whitespace();
        parse(&mut words)
            .filter(|_| words.next().is_none())
            .ok_or_else(|| UnknownCommand { line: line.trim().to_owned() })
    }
}

fn parse<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<EmulatorCommand> {
    let name = words.next()?;
    let kind = match name {
        "status" => return Some(EmulatorCommand::Status),
        "pose" => return pose(words),
        "restart" => return Some(EmulatorCommand::Restart),
        "unplug" => return Some(EmulatorCommand::Unplug { for_s: seconds(words.next()?)? }),
        "beam-blocked" => FaultKind::BeamBlocked,
        "psd-dark" => FaultKind::PsdDark { psd: number(words.next()?)? },
        "clipped" => FaultKind::Clipped { channel: number(words.next()?)? },
        "frozen" => FaultKind::Frozen { channel: number(words.next()?)? },
        "readback-frozen" => FaultKind::ReadbackFrozen,
        "clock-rate" => FaultKind::ClockRate { factor: number(words.next()?)? },
        "dropped" => FaultKind::Dropped { fraction: number(words.next()?)? },
        "corrupted" => FaultKind::Corrupted { fraction: number(words.next()?)? },
        "stalled" => FaultKind::Stalled,
        "bursts" => FaultKind::Bursts { interval_ms: number(words.next()?)? },
        "mute-acks" => FaultKind::MuteAcks,
        "wrong-acks" => FaultKind::WrongAcks,
        "steering-stuck" => FaultKind::SteeringStuck,
        "laser-power" => FaultKind::LaserPower { factor: number(words.next()?)? },
        "flicker" => {
            FaultKind::Flicker { fraction: number(words.next()?)?, frequency_hz: number(words.next()?)? }
        }
        "ambient-light" => FaultKind::AmbientLight { fraction: number(words.next()?)? },
        "noise-burst" => FaultKind::NoiseBurst { factor: number(words.next()?)? },
        "laser-bump" => FaultKind::LaserBump { shift_um: [number(words.next()?)?, number(words.next()?)?] },
        _ => return None,
    };
    let for_s = match words.next() {
        Some(word) => Some(seconds(word)?),
        None => None,
    };
    let fault = Fault { at_s: 0.0, for_s, kind };
    fault.is_possible().then_some(EmulatorCommand::Fault { kind, for_s })
}

fn pose<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<EmulatorCommand> {
    let mut micro = [0.0; 6];
    for x in &mut micro {
        *x = number(words.next()?)?;
    }
    let over_s = words.next().map_or(Some(DEFAULT_S), number)?;
    MirrorMove { micro, over_s }.checked().ok().map(EmulatorCommand::Pose)
}

fn number<T: FromStr>(word: &str) -> Option<T> {
    word.parse().ok()
}

fn seconds(word: &str) -> Option<f64> {
    number(word).filter(|s| (0.0..=LONGEST_S).contains(s))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_are_parsed_with_and_without_a_duration() {
        let fault = |kind, for_s| Ok(EmulatorCommand::Fault { kind, for_s });
        assert_eq!("beam-blocked 0.5".parse(), fault(FaultKind::BeamBlocked, Some(0.5)));
        assert_eq!(" psd-dark 1 ".parse(), fault(FaultKind::PsdDark { psd: 1 }, None));
        assert_eq!("dropped 0.1 2".parse(), fault(FaultKind::Dropped { fraction: 0.1 }, Some(2.0)));
        assert_eq!("laser-power 1.1 2".parse(), fault(FaultKind::LaserPower { factor: 1.1 }, Some(2.0)));
        let flicker = FaultKind::Flicker { fraction: 0.05, frequency_hz: 100.0 };
        assert_eq!("flicker 0.05 100 2".parse(), fault(flicker, Some(2.0)));
        let bump = FaultKind::LaserBump { shift_um: [-30.0, 5.0] };
        assert_eq!("laser-bump -30 5 1".parse(), fault(bump, Some(1.0)));
        assert_eq!("restart".parse(), Ok(EmulatorCommand::Restart));
        assert_eq!("unplug 1".parse(), Ok(EmulatorCommand::Unplug { for_s: 1.0 }));
        let there = |over_s| MirrorMove { micro: [1.0, -2.0, 3.0, 4.0, 5.0, -6e3], over_s };
        assert_eq!("pose 1 -2 3 4 5 -6e3".parse(), Ok(EmulatorCommand::Pose(there(DEFAULT_S))));
        assert_eq!("pose 1 -2 3 4 5 -6e3 0".parse(), Ok(EmulatorCommand::Pose(there(0.0))));
        assert_eq!("status".parse(), Ok(EmulatorCommand::Status));
    }

    #[test]
    fn invalid_orders_are_answered_with_the_allowed_ones() {
        for line in [
            "",
            "jump",
            "unplug",
            "unplug -1",
            "unplug nan",
            "unplug 1e300",
            "pose",
            "pose 1 2 3 4 5",
            "pose 1 2 3 4 5 nan",
            "pose 1e5 0 0 0 0 0",
            "pose 1 2 3 4 5 6 -1",
            "pose 1 2 3 4 5 6 1 1",
            "psd-dark",
            "psd-dark 3",
            "clipped 9",
            "frozen 9",
            "clock-rate -1",
            "dropped 1.5",
            "bursts",
            "bursts 0",
            "corrupted nan",
            "stalled 1 2",
            "status now",
            "laser-power -1",
            "flicker 0.05",
            "flicker 2 100",
            "noise-burst inf",
            "laser-bump 1",
            "laser-bump 1 nan",
        ] {
            let error = line.parse::<EmulatorCommand>().unwrap_err().to_string();
            assert!(error.contains(&format!("`{line}`")) && error.contains("steering-stuck [S]"), "{error}");
        }
    }
}
