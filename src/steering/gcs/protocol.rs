//! PI's General Command Set 2.0, as far as a stage with two axes needs it: lines of ASCII. Pure.
//!
//! A command is a line without an answer; its result is the answer to `ERR?`. A query is a line whose name
//! ends with a question mark. Its answer has one or more lines; every line but the last ends with a space
//! before the line feed.

/// Names of two axes, as configured in the controller.
pub type Axes = [String; 2];

/// Largest length of a line of an answer, bytes.
const LINE: usize = 256;
/// Largest number of lines of an answer; two axes need two.
const LINES: usize = 8;

/// Queries to a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GcsQuery {
    /// Maker, model, serial number and version.
    Identity,
    /// Code of the last error; the query clears it.
    Error,
    /// Whether the axes are in closed loop.
    Servo,
    /// Whether the axes are referenced.
    Referenced,
    /// Unit of position of the axes.
    Unit,
    /// Lower end of the travel.
    Lowest,
    /// Upper end of the travel.
    Highest,
    /// Velocity of motions.
    Velocity,
    /// Position of the axes.
    Position,
}

impl GcsQuery {
    /// The line of the query.
    pub fn line(self, axes: &Axes) -> String {
        let name = match self {
            Self::Identity => return "*IDN?\n".into(),
            Self::Error => return "ERR?\n".into(),
            Self::Servo => "SVO?",
            Self::Referenced => "FRF?",
            Self::Unit => "PUN?",
            Self::Lowest => "TMN?",
            Self::Highest => "TMX?",
            Self::Velocity => "VEL?",
            Self::Position => "POS?",
        };
        format!("{name} {} {}\n", axes[0], axes[1])
    }
}

/// The line that moves both axes, followed by the query for its result; positions in the unit of the
/// controller. `None` if a position is not finite: such a line is never sent.
pub fn move_to(axes: &Axes, position: [f64; 2]) -> Option<String> {
    let [x, y] = position;
    let fine = x.is_finite() && y.is_finite();
    // Seven digits are 0.1 nm if the unit is the millimetre.
    fine.then(|| format!("MOV {} {x:.7} {} {y:.7}\nERR?\n", axes[0], axes[1]))
}

/// The line that switches the servo of both axes on, followed by the query for its result.
pub fn servo_on(axes: &Axes) -> String {
    format!("SVO {} 1 {} 1\nERR?\n", axes[0], axes[1])
}

/// Reasons why bytes are not a valid answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AnswerError {
    /// Longer than any answer.
    #[error("longer than {LINES} lines of {LINE} bytes")]
    TooLong,
    /// A byte that is not text.
    #[error("the byte 0x{0:02x} is not text")]
    NotText(u8),
    /// Data after the end of the answer.
    #[error("{0:?} after the end of the answer")]
    Surplus(String),
    /// Text with another meaning.
    #[error("{received:?}, expected {expected}")]
    Unexpected {
        /// The expected form.
        expected: String,
        /// The received text.
        received: String,
    },
}

/// Assembles an answer from bytes as they arrive.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Answer {
    lines: Vec<String>,
    /// The last line, as far as received.
    line: String,
    complete: bool,
}

impl Answer {
    /// Takes bytes; returns whether the answer is complete.
    ///
    /// # Errors
    /// The answer is too long, not text, or followed by more data.
    pub fn push(&mut self, bytes: &[u8]) -> Result<bool, AnswerError> {
        for (i, &byte) in bytes.iter().enumerate() {
            if self.complete {
                return Err(AnswerError::Surplus(shown(bytes[i..].iter().copied().map(char::from))));
            }
            match byte {
                b'\n' => self.end_line()?,
                // Latin-1, for the micro sign of a unit.
                b' '..=b'~' | 0xa0.. if self.line.chars().count() < LINE => self.line.push(byte.into()),
                b' '..=b'~' | 0xa0.. => return Err(AnswerError::TooLong),
                _ => return Err(AnswerError::NotText(byte)),
            }
        }
        Ok(self.complete)
    }

    fn end_line(&mut self) -> Result<(), AnswerError> {
        let line = std::mem::take(&mut self.line);
        self.complete = !line.ends_with(' ');
        self.lines.push(line.trim_end().into());
        if self.lines.len() == LINES && !self.complete { Err(AnswerError::TooLong) } else { Ok(()) }
    }

    /// The received part, as shown in messages.
    pub fn so_far(&self) -> String {
        shown(self.lines.iter().flat_map(|line| line.chars().chain([' '])).chain(self.line.chars()))
    }

    /// The answer as a single line.
    ///
    /// # Errors
    /// The answer has more than one line.
    pub fn line(&self, expected: &str) -> Result<&str, AnswerError> {
        match &self.lines[..] {
            [line] => Ok(line),
            _ => Err(self.unexpected(expected)),
        }
    }

    /// The answer as an error code.
    ///
    /// # Errors
    /// The answer is not an integer.
    pub fn code(&self) -> Result<i32, AnswerError> {
        const EXPECTED: &str = "an error code";
        self.line(EXPECTED)?.trim().parse().map_err(|_| self.unexpected(EXPECTED))
    }

    /// The answer as one finite number per axis.
    ///
    /// # Errors
    /// The answer has another form.
    pub fn numbers(&self, axes: &Axes) -> Result<[f64; 2], AnswerError> {
        self.of_axes(axes, "a number", |text| text.parse().ok().filter(|x: &f64| x.is_finite()))
    }

    /// The answer as one flag per axis.
    ///
    /// # Errors
    /// The answer has another form.
    pub fn flags(&self, axes: &Axes) -> Result<[bool; 2], AnswerError> {
        self.of_axes(axes, "0 or 1", |text| match text {
            "0" => Some(false),
            "1" => Some(true),
            _ => None,
        })
    }

    /// The answer as one word per axis.
    ///
    /// # Errors
    /// The answer has another form.
    pub fn words(&self, axes: &Axes) -> Result<[String; 2], AnswerError> {
        self.of_axes(axes, "a word", |text| Some(text.to_owned()))
    }

    /// The values of the axes, one per line, in the order of the query.
    fn of_axes<T>(
        &self,
        axes: &Axes,
        kind: &str,
        read: impl Fn(&str) -> Option<T>,
    ) -> Result<[T; 2], AnswerError> {
        let value = |line: &String, axis: &String| {
            let (name, value) = line.split_once('=')?;
            if name.trim() == axis { read(value.trim()) } else { None }
        };
        if let [a, b] = &self.lines[..]
            && let (Some(a), Some(b)) = (value(a, &axes[0]), value(b, &axes[1]))
        {
            return Ok([a, b]);
        }
        Err(self.unexpected(&format!("{}= and {}=, each with {kind}", axes[0], axes[1])))
    }

    fn unexpected(&self, expected: &str) -> AnswerError {
        AnswerError::Unexpected { expected: expected.into(), received: self.so_far().trim_end().into() }
    }
}

/// The text, shortened for a message.
fn shown(text: impl Iterator<Item = char>) -> String {
    text.take(80).collect()
}

#[cfg(test)]
mod tests;
