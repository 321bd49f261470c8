//! PI's General Command Set 2.0, as far as a stage of two axes needs it: lines of ASCII. Pure.
//!
//! A command is a line and has no answer; what became of it is the answer to `ERR?`. A question is a line
//! that ends its name with a question mark. Its answer has one or more lines; every line but the last ends
//! with a space before the line feed.

/// The names of two axes, as the controller knows them.
pub type Axes = [String; 2];

/// A line of an answer never has more bytes than this.
const LINE: usize = 256;
/// An answer never has more lines than this: two axes need two.
const LINES: usize = 8;

/// What a controller is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GcsQuery {
    /// Who it is.
    Identity,
    /// The code of the last error, which is forgotten thereby.
    Error,
    /// Whether the axes are in closed loop.
    Servo,
    /// Whether the axes are referenced.
    Referenced,
    /// The unit of position of the axes.
    Unit,
    /// The low end of the travel.
    Lowest,
    /// The high end of the travel.
    Highest,
    /// The velocity of a motion.
    Velocity,
    /// Where the axes stand.
    Position,
}

impl GcsQuery {
    /// The line that asks it.
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

/// The line that moves both axes, and the question what became of it; positions in the controller's
/// unit. None if one of them is no number: such a line never goes out.
pub fn move_to(axes: &Axes, position: [f64; 2]) -> Option<String> {
    let [x, y] = position;
    let fine = x.is_finite() && y.is_finite();
    // Seven digits are 0.1 nm where the unit is the millimetre.
    fine.then(|| format!("MOV {} {x:.7} {} {y:.7}\nERR?\n", axes[0], axes[1]))
}

/// The line that closes the loop of both axes, and the question what became of it.
pub fn servo_on(axes: &Axes) -> String {
    format!("SVO {} 1 {} 1\nERR?\n", axes[0], axes[1])
}

/// Why bytes are not the answer that was asked for.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AnswerError {
    /// More than any answer has.
    #[error("more than an answer can have: lines of {LINE} bytes, {LINES} of them")]
    TooLong,
    /// Bytes that are no text.
    #[error("the byte 0x{0:02x}, which is no text")]
    NotText(u8),
    /// Something after the end of the answer.
    #[error("{0:?} after its end")]
    Surplus(String),
    /// Text that means something else.
    #[error("{received:?} where {expected} was expected")]
    Unexpected {
        /// What it should have looked like.
        expected: String,
        /// What came.
        received: String,
    },
}

/// Puts an answer together from the bytes as they come.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Answer {
    lines: Vec<String>,
    /// The last line, as far as it has come.
    line: String,
    complete: bool,
}

impl Answer {
    /// Takes bytes; says whether the answer is complete.
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

    /// What has come so far, for people.
    pub fn so_far(&self) -> String {
        shown(self.lines.iter().flat_map(|line| line.chars().chain([' '])).chain(self.line.chars()))
    }

    /// The answer as its single line.
    pub fn line(&self, expected: &str) -> Result<&str, AnswerError> {
        match &self.lines[..] {
            [line] => Ok(line),
            _ => Err(self.unexpected(expected)),
        }
    }

    /// The error code that the answer is.
    pub fn code(&self) -> Result<i32, AnswerError> {
        const EXPECTED: &str = "an error code";
        self.line(EXPECTED)?.trim().parse().map_err(|_| self.unexpected(EXPECTED))
    }

    /// The finite number of each axis.
    pub fn numbers(&self, axes: &Axes) -> Result<[f64; 2], AnswerError> {
        self.of_axes(axes, "a number", |text| text.parse().ok().filter(|x: &f64| x.is_finite()))
    }

    /// The yes or no of each axis.
    pub fn flags(&self, axes: &Axes) -> Result<[bool; 2], AnswerError> {
        self.of_axes(axes, "0 or 1", |text| match text {
            "0" => Some(false),
            "1" => Some(true),
            _ => None,
        })
    }

    /// The words of each axis.
    pub fn words(&self, axes: &Axes) -> Result<[String; 2], AnswerError> {
        self.of_axes(axes, "a word", |text| Some(text.to_owned()))
    }

    /// The values of the axes, one a line, in the order in which they were asked for.
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
        Err(self.unexpected(&format!("{}= and {}=, each with {kind},", axes[0], axes[1])))
    }

    fn unexpected(&self, expected: &str) -> AnswerError {
        AnswerError::Unexpected { expected: expected.into(), received: self.so_far().trim_end().into() }
    }
}

/// Not more of it than fits into a message.
fn shown(text: impl Iterator<Item = char>) -> String {
    text.take(80).collect()
}

#[cfg(test)]
mod tests;
