//! Input quantities of a measurement model.

/// The probability distribution of an input quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distribution {
    /// Gaussian (JCGM 101, 6.4.7).
    Normal,
    /// Uniform between two limits (6.4.2); the half-width is the standard uncertainty times the root of 3.
    Rectangular,
    /// Uniform between limits that are themselves known only within plus and minus `inexactness` times the
    /// half-width (6.4.3), 0 to 1.
    CurvilinearTrapezoid {
        /// Half-width of the limits relative to that of the distribution.
        inexactness: f64,
    },
    /// Triangular (6.4.5); the half-width is the standard uncertainty times the root of 6.
    Triangular,
    /// Arc sine, U-shaped: a quantity that cycles between two limits (6.4.6); the half-width is the standard
    /// uncertainty times the root of 2.
    Arcsine,
    /// Student's t, scaled and shifted (6.4.9), with the degrees of freedom of the input. The scale is the
    /// standard uncertainty of JCGM 100 (s over the root of n): the standard deviation is larger.
    StudentT,
}

impl Distribution {
    /// Half-width over standard uncertainty. `None` for a distribution without limits.
    pub fn half_width(self) -> Option<f64> {
        match self {
            Self::Normal | Self::StudentT => None,
            Self::Rectangular => Some(3.0_f64.sqrt()),
            // u^2 = w^2/3 + d^2/9 with d = inexactness * w.
            Self::CurvilinearTrapezoid { inexactness } => {
                Some(1.0 / (1.0 / 3.0 + inexactness.powi(2) / 9.0).sqrt())
            }
            Self::Triangular => Some(6.0_f64.sqrt()),
            Self::Arcsine => Some(2.0_f64.sqrt()),
        }
    }

    /// The name of the distribution.
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::Rectangular => "rectangular",
            Self::CurvilinearTrapezoid { .. } => "trapezoidal",
            Self::Triangular => "triangular",
            Self::Arcsine => "arcsine",
            Self::StudentT => "t",
        }
    }
}

/// How a standard uncertainty was evaluated (JCGM 100, 2.3.2 and 2.3.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Evaluation {
    /// By statistics of a series of observations.
    A,
    /// By other means: a certificate, a data sheet, experience.
    B,
}

impl Evaluation {
    /// "A" or "B".
    pub fn name(self) -> &'static str {
        match self {
            Self::A => "A",
            Self::B => "B",
        }
    }
}

/// An input quantity.
#[derive(Clone, Debug, PartialEq)]
pub struct Input {
    /// Name of the quantity.
    pub name: String,
    /// Its estimate.
    pub value: f64,
    /// Its standard uncertainty, in the same unit.
    pub std: f64,
    /// Its probability distribution.
    pub distribution: Distribution,
    /// Type A or B.
    pub evaluation: Evaluation,
    /// Degrees of freedom of the standard uncertainty; infinite if it is known exactly.
    pub dof: f64,
}

impl Input {
    /// An input of type B with infinitely many degrees of freedom.
    pub fn new(name: impl Into<String>, value: f64, std: f64, distribution: Distribution) -> Self {
        Self { name: name.into(), value, std, distribution, evaluation: Evaluation::B, dof: f64::INFINITY }
    }

    /// A normally distributed input of type B with infinitely many degrees of freedom.
    pub fn normal(name: impl Into<String>, value: f64, std: f64) -> Self {
        Self::new(name, value, std, Distribution::Normal)
    }

    /// An input of type B that is within plus and minus `half_width` of its value. `None` for a distribution
    /// without limits.
    pub fn limited(
        name: impl Into<String>,
        value: f64,
        half_width: f64,
        distribution: Distribution,
    ) -> Option<Self> {
        Some(Self::new(name, value, half_width / distribution.half_width()?, distribution))
    }

    /// The input with this type of evaluation and these degrees of freedom.
    #[must_use]
    pub fn evaluated(mut self, evaluation: Evaluation, dof: f64) -> Self {
        (self.evaluation, self.dof) = (evaluation, dof);
        self
    }
}
