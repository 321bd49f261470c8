//! Why a stage does not take commands, in words that say what to do.

use super::protocol::AnswerError;

/// What goes wrong with a controller.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// There is no way to it.
    #[error("cannot connect to {line}: {reason}")]
    Connect {
        /// Its address, or port.
        line: String,
        /// What the system says.
        reason: String,
    },
    /// It does not answer in time.
    #[error("no answer to {asked} within {ms} ms{}", .so_far.as_ref().map_or(String::new(), |s| format!(", only {s:?}")))]
    Silent {
        /// The question.
        asked: String,
        /// `steering.gcs.timeout_ms`.
        ms: u16,
        /// What came of the answer.
        so_far: Option<String>,
    },
    /// The connection is gone.
    #[error("{line} is gone, at {asked}: {reason}")]
    Gone {
        /// Its address, or port.
        line: String,
        /// The question.
        asked: String,
        /// What the system says.
        reason: String,
    },
    /// It talks without being asked: an answer that comes late, or another program on the same line.
    #[error(
        "it said {0:?} without being asked: is steering.gcs.timeout_ms too short, or does another program use it?"
    )]
    Unasked(String),
    /// It answers something else.
    #[error("the answer to {asked} was {error}")]
    Answer {
        /// The question.
        asked: String,
        /// What is wrong with it.
        error: AnswerError,
    },
    /// It has refused a command, or cannot answer a question.
    #[error("it answered {asked} with error {code}: {}", context(*.code))]
    Refused {
        /// The command, or question.
        asked: String,
        /// Its error code.
        code: i32,
    },
    /// It works, and cannot be used so.
    #[error("{0}")]
    Unfit(String),
}

/// No error.
pub const FINE: i32 = 0;
/// A name that the controller does not know.
pub const UNKNOWN_COMMAND: i32 = 2;
/// A position that the axis cannot go to.
pub const OUT_OF_LIMITS: i32 = 7;
/// A command that this kind of stage does not have.
pub const NOT_FOR_THIS_STAGE: i32 = 34;

/// The error codes of the command set that may come here, in words.
pub fn context(code: i32) -> &'static str {
    match code {
        FINE => "no error",
        1 | 24 | 25 | 26 => "it does not understand the numbers in it",
        UNKNOWN_COMMAND => "it does not know this command",
        3 | 76 => "the line was too long, or came too fast",
        5 | 88 => "the axis is not referenced, or its servo is off",
        OUT_OF_LIMITS | 17 | 27 => "the position is beyond the limits of the axis",
        8 => "the velocity is beyond the limits of the axis",
        10 => "the axis was stopped by a stop command",
        15 | 22 | 23 => "it has no axis of that name (steering.gcs.axes)",
        NOT_FOR_THIS_STAGE => "this kind of stage does not have the command",
        45 => "referencing has failed",
        51 | 83 => "a joystick has the axis",
        52 => "it has received damaged bytes",
        53 | 93 => "the axis is still busy with another motion",
        60 => "it is protected by a password",
        61 => "an automatic zero search is running",
        63 => "it is still starting",
        72 => "an analog input has the axis",
        73 => "its wave generator has the axis",
        84 => "the motor is switched off",
        89 => "not in the present mode of motion",
        91 => "the motion would end in a collision",
        200 => "there is no stage at the axis",
        214 | 215 => "the cable between controller and stage may be broken",
        216 => "the stage has run into a limit switch",
        _ => "see the list of error codes in the controller's manual",
    }
}
