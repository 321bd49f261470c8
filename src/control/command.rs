//! Commands to a daemon: one line of ASCII each.

use std::fmt;
use std::str::FromStr;

use trifacet_core::centering::LoopMode;
use trifacet_core::telemetry::heartbeat::{Drill, Task};

use crate::recording::RecorderCommand;
use crate::twin::MirrorMove;
use crate::twin::moves::DEFAULT_S;

/// A command. [`ALLOWED`] lists their syntax.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Queries the state.
    Status,
    /// Makes the present pose the zero of later ones.
    Tare {
        /// Number of poses to average; by default those of 0.1 s.
        poses: Option<u32>,
        /// Also write the tare to the configuration file.
        save: bool,
    },
    /// Removes the tare.
    ClearTare {
        /// Also remove it from the configuration file.
        save: bool,
    },
    /// Sets the mode of the loop.
    Loop(LoopMode),
    /// Sets the target position of the beam relative to the apex, micrometres.
    Setpoint([f64; 2]),
    /// Sets the gains of the loop.
    Gains {
        /// Proportional gain.
        kp: f64,
        /// Integral gain, per second.
        ki_per_s: f64,
    },
    /// Moves the stage to this position, micrometres; only in manual mode.
    Move([f64; 2]),
    /// Switches the loop to manual mode and parks the stage.
    Park,
    /// Starts a search for the apex.
    Search,
    /// Moves the beam over a small pattern and tests whether the pose depends on it.
    SelfCheck,
    /// Moves the mirror of the twin; twin only.
    TwinPose(MirrorMove),
    /// Makes a task stall or end, to test the supervision; twin only.
    Drill(Drill, Task),
    /// Queries the state of the recorder.
    Recording,
    /// Commands the recorder.
    Record(RecorderCommand),
    /// Reads the configuration file again.
    Reload,
}

/// A line that is not a command.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{found:?} is not a command; allowed: {ALLOWED}")]
pub struct NoCommand {
    found: String,
}

/// The syntax of every command.
pub const ALLOWED: &str = "status, tare [poses=N] [save], tare clear [save], loop on|off|shadow|manual, \
    setpoint X_UM Y_UM, gains KP KI_PER_S, move X_UM Y_UM, park, search, self-check, reload, \
    record start|stop|trigger|status, \
    twin-pose TX_UM TY_UM TZ_UM ROLL_URAD PITCH_URAD YAW_URAD [over_s=S], \
    drill stall|block|end acquisition|centering|estimation";

impl FromStr for Command {
    type Err = NoCommand;

    fn from_str(line: &str) -> Result<Self, NoCommand> {
        let words: Vec<_> = line.split_ascii_whitespace().collect();
        let word = words.first().map(|word| word.to_ascii_lowercase()).unwrap_or_default();
        parse(&word, words.get(1..).unwrap_or_default())
            .ok_or_else(|| NoCommand { found: line.trim().chars().take(60).collect() })
    }
}

fn parse(word: &str, rest: &[&str]) -> Option<Command> {
    Some(match (word, rest) {
        ("status", []) => Command::Status,
        ("reload", []) => Command::Reload,
        ("loop", [mode]) => Command::Loop(LoopMode::ALL.into_iter().find(|m| m.name() == *mode)?),
        ("park", []) => Command::Park,
        ("record", ["status"]) => Command::Recording,
        ("record", [action]) => {
            Command::Record(RecorderCommand::ALL.into_iter().find(|w| w.name() == *action)?)
        }
        ("search", []) => Command::Search,
        ("self-check", []) => Command::SelfCheck,
        ("move", [x, y]) => Command::Move([number(x)?, number(y)?]),
        ("twin-pose", [pose @ .., last]) if last.starts_with("over_s=") => {
            twin_pose(pose, number(last.strip_prefix("over_s=")?)?)?
        }
        ("twin-pose", pose) => twin_pose(pose, DEFAULT_S)?,
        ("drill", [drill, task]) => Command::Drill(
            Drill::ALL.into_iter().find(|d| d.name() == *drill)?,
            Task::ALL.into_iter().find(|t| t.name() == *task)?,
        ),
        ("setpoint", [x, y]) => Command::Setpoint([number(x)?, number(y)?]),
        ("gains", [kp, ki]) => Command::Gains { kp: number(kp)?, ki_per_s: number(ki)? },
        ("tare", ["clear"]) => Command::ClearTare { save: false },
        ("tare", ["clear", "save"]) => Command::ClearTare { save: true },
        ("tare", options) => {
            let (options, save) = match options {
                [options @ .., "save"] => (options, true),
                options => (options, false),
            };
            let poses = match options {
                [] => None,
                [poses] => Some(poses.strip_prefix("poses=")?.parse().ok().filter(|n| *n > 0)?),
                _ => return None,
            };
            Command::Tare { poses, save }
        }
        _ => return None,
    })
}

fn twin_pose(words: &[&str], over_s: f64) -> Option<Command> {
    let numbers: Vec<_> = words.iter().map(|word| number(word)).collect::<Option<_>>()?;
    Some(Command::TwinPose(MirrorMove { micro: numbers.try_into().ok()?, over_s }))
}

fn number(text: &str) -> Option<f64> {
    text.parse().ok().filter(|x: &f64| x.is_finite())
}

/// The line that [`FromStr`] parses.
impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let save = |save: bool| if save { " save" } else { "" };
        match *self {
            Command::Status => f.write_str("status"),
            Command::Tare { poses: None, save: s } => write!(f, "tare{}", save(s)),
            Command::Tare { poses: Some(n), save: s } => write!(f, "tare poses={n}{}", save(s)),
            Command::ClearTare { save: s } => write!(f, "tare clear{}", save(s)),
            Command::Loop(mode) => write!(f, "loop {}", mode.name()),
            Command::Setpoint([x, y]) => write!(f, "setpoint {x:?} {y:?}"),
            Command::Gains { kp, ki_per_s } => write!(f, "gains {kp:?} {ki_per_s:?}"),
            Command::Move([x, y]) => write!(f, "move {x:?} {y:?}"),
            Command::Park => f.write_str("park"),
            Command::Search => f.write_str("search"),
            Command::SelfCheck => f.write_str("self-check"),
            Command::TwinPose(MirrorMove { micro: [x, y, z, roll, pitch, yaw], over_s }) => {
                write!(f, "twin-pose {x:?} {y:?} {z:?} {roll:?} {pitch:?} {yaw:?} over_s={over_s:?}")
            }
            Command::Drill(drill, task) => write!(f, "drill {} {task}", drill.name()),
            Command::Recording => f.write_str("record status"),
            Command::Record(action) => write!(f, "record {}", action.name()),
            Command::Reload => f.write_str("reload"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_survive_a_round_trip() {
        let commands = [
            Command::Status,
            Command::Tare { poses: None, save: false },
            Command::Tare { poses: Some(250), save: true },
            Command::ClearTare { save: false },
            Command::ClearTare { save: true },
            Command::Loop(LoopMode::On),
            Command::Loop(LoopMode::Off),
            Command::Loop(LoopMode::Shadow),
            Command::Loop(LoopMode::Manual),
            Command::Move([-100.5, 0.0]),
            Command::Park,
            Command::Search,
            Command::SelfCheck,
            Command::Setpoint([-1.5, 1e-3]),
            Command::Gains { kp: 0.1, ki_per_s: 200.0 },
            Command::Recording,
            Command::Record(RecorderCommand::Start),
            Command::Record(RecorderCommand::Stop),
            Command::Record(RecorderCommand::Trigger),
            Command::TwinPose(MirrorMove { micro: [1.0, -2.5, 1e-3, 0.0, -5000.0, 6.0], over_s: 0.25 }),
            Command::Drill(Drill::Stall, Task::Centering),
            Command::Drill(Drill::Block, Task::Acquisition),
            Command::Drill(Drill::End, Task::Estimation),
            Command::Reload,
        ];
        for command in commands {
            assert_eq!(command.to_string().parse(), Ok(command));
        }
        let at_default_speed = MirrorMove { micro: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], over_s: DEFAULT_S };
        assert_eq!("twin-pose 1 2 3 4 5 6".parse(), Ok(Command::TwinPose(at_default_speed)));
        assert_eq!(" LOOP  on\r".parse(), Ok(Command::Loop(LoopMode::On)));
    }

    #[test]
    fn invalid_commands_are_refused_with_the_allowed_ones() {
        let bad = [
            "",
            "statuss",
            "status now",
            "tare 100",
            "tare poses=0",
            "tare poses=-3",
            "tare poses=1e3",
            "tare save poses=5",
            "tare clear all",
            "loop",
            "loop maybe",
            "park here",
            "move 1",
            "move nan 0",
            "search far",
            "self-check now",
            "setpoint 1",
            "setpoint 1 2 3",
            "setpoint nan 0",
            "gains 0.1",
            "gains inf 1",
            "gains 0,1 200",
            "twin-pose",
            "twin-pose 1 2 3 4 5",
            "twin-pose 1 2 3 4 5 6 7",
            "twin-pose 1 2 3 4 5 nan",
            "twin-pose 1 2 3 4 5 6 over_s=",
            "twin-pose 1 2 3 4 5 6 2",
            "reload /etc/passwd",
            "record",
            "record on",
            "record start now",
            "drill",
            "drill stall",
            "drill stall publishing",
            "drill kill centering",
            "\u{fc}",
        ];
        for line in bad {
            let error = line.parse::<Command>().unwrap_err().to_string();
            assert!(error.contains("setpoint X_UM Y_UM"), "{line}: {error}");
        }
    }
}
