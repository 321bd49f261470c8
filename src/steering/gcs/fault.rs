//! Faults of a controller, with messages that name the remedy.

use super::protocol::AnswerError;
use super::unit::UnitError;

/// A fault of a controller.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// The connection cannot be established.
    #[error("cannot connect to {line}: {reason}")]
    Connect {
        /// Address or port.
        line: String,
        /// Error message of the system.
        reason: String,
    },
    /// The controller does not answer in time.
    #[error("no answer to {asked} within {ms} ms{}", .so_far.as_ref().map_or(String::new(), |s| format!(", only {s:?}")))]
    Silent {
        /// The query.
        asked: String,
        /// `steering.gcs.timeout_ms`.
        ms: u16,
        /// The received part of the answer.
        so_far: Option<String>,
    },
    /// The connection is lost.
    #[error("{line} was lost during {asked}: {reason}")]
    Gone {
        /// Address or port.
        line: String,
        /// The query.
        asked: String,
        /// Error message of the system.
        reason: String,
    },
    /// Data arrived without a query: a late answer, or another program on the same line.
    #[error(
        "unexpected data {0:?}: is steering.gcs.timeout_ms too short, or does another program use the controller?"
    )]
    Unasked(String),
    /// The answer is invalid.
    #[error("invalid answer to {asked}: {error}")]
    Answer {
        /// The query.
        asked: String,
        /// The error in the answer.
        error: AnswerError,
    },
    /// The controller has rejected a command or a query.
    #[error("{asked} returned error {code}: {}", context(*.code))]
    Refused {
        /// The command or query.
        asked: String,
        /// Error code of the controller.
        code: i32,
    },
    /// The controller works, but cannot be used with this configuration.
    #[error("{0}")]
    Unfit(String),
    /// The unit of an axis does not suit the configuration.
    #[error(transparent)]
    Unit(#[from] UnitError),
}

/// No error.
pub const FINE: i32 = 0;
/// The controller does not know the command.
pub const UNKNOWN_COMMAND: i32 = 2;
/// The axis cannot reach the position.
pub const OUT_OF_LIMITS: i32 = 7;
/// The command does not apply to this kind of stage.
pub const NOT_FOR_THIS_STAGE: i32 = 34;

/// Meaning of an error code of the command set.
pub fn context(code: i32) -> &'static str {
    match code {
        FINE => "no error",
        1 | 24 | 25 | 26 => "the controller does not accept the parameters",
        UNKNOWN_COMMAND => "the controller does not know this command",
        3 | 76 => "the line was too long or arrived too fast",
        5 | 88 => "the axis is not referenced, or its servo is off",
        OUT_OF_LIMITS | 17 | 27 => "the position is beyond the limits of the axis",
        8 => "the velocity is beyond the limits of the axis",
        10 => "the axis was stopped by a stop command",
        15 | 22 | 23 => "the controller has no axis of that name (steering.gcs.axes)",
        NOT_FOR_THIS_STAGE => "this kind of stage does not have the command",
        45 => "referencing has failed",
        51 | 83 => "a joystick controls the axis",
        52 => "the controller has received damaged bytes",
        53 | 93 => "the axis is still busy with another motion",
        60 => "the command is protected by a password",
        61 => "an automatic zero search is running",
        63 => "the controller is still starting",
        72 => "an analog input controls the axis",
        73 => "the wave generator controls the axis",
        84 => "the motor is switched off",
        89 => "not possible in the present mode of motion",
        91 => "the motion would end in a collision",
        200 => "no stage is connected to the axis",
        214 | 215 => "the cable between controller and stage may be broken",
        216 => "the stage has run into a limit switch",
        _ => "see the list of error codes in the controller's manual",
    }
}
