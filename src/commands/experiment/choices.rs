//! Builds the protocol from the command line.

use trifacet::client::Endpoint;
use trifacet::config::Axis;
use trifacet::exit::{self, Failure};
use trifacet::experiment::protocol::{Course, Protocol, printed};
use trifacet::experiment::quantity::{self, QuantityError};
use trifacet::experiment::reference;

use super::ExperimentArgs;

/// Longest interval, metres or radians.
const MOST: f64 = 1e-3;

/// The protocol for these options.
pub(super) fn protocol(args: &ExperimentArgs) -> Result<Protocol, Failure> {
    let wanted = |axis: &Axis| args.axes.is_empty() || args.axes.contains(axis);
    for (before, (axis, _)) in args.interval.iter().enumerate() {
        let name = axis.name();
        let what = if !wanted(axis) {
            format!("--interval {name}: {name} is not among the --axes")
        } else if args.interval[..before].iter().any(|(other, _)| other == axis) {
            format!("--interval contains {name} twice")
        } else {
            continue;
        };
        return Err(Failure::new(exit::USAGE, what));
    }
    let courses: Vec<Course> = match &args.reference {
        Some(file) => {
            let courses = reference::read(file)?;
            if let Some(axis) = args.axes.iter().find(|axis| courses.iter().all(|c| c.axis != **axis)) {
                let message = format!("{}: the file contains no readings of {}", file.display(), axis.name());
                return Err(Failure::new(exit::DATA, message));
            }
            courses.into_iter().filter(|c| wanted(&c.axis)).collect()
        }
        None => Axis::ALL.into_iter().filter(wanted).map(|axis| course(args, axis)).collect(),
    };
    if let (Some(short), Some(file)) = (courses.iter().find(|c| c.points.len() < 3), &args.reference) {
        let (name, n) = (short.axis.name(), short.points.len());
        let message = format!("{}: {name} has {n} points: at least 3 are needed", file.display());
        return Err(Failure::new(exit::DATA, message));
    }
    Ok(Protocol { courses, readings: args.readings })
}

fn course(args: &ExperimentArgs, axis: Axis) -> Course {
    let own = args.interval.iter().find(|(a, _)| *a == axis).map(|(_, interval)| *interval);
    Course::even(axis, own.unwrap_or(printed(axis).interval * 1e-6), args.points)
}

/// Why the value of an option is not valid.
#[derive(Debug, thiserror::Error)]
pub(super) enum OptionError {
    /// Not the name of an axis.
    #[error("allowed are tx, ty, tz, roll, pitch, yaw")]
    Axis,
    /// Not an axis with an interval.
    #[error("must be AXIS=X, such as tx=1.44")]
    Interval,
    /// The interval is not a length or an angle.
    #[error(transparent)]
    Quantity(#[from] QuantityError),
    /// The interval is out of range for the axis.
    #[error("must be above 0 and at most 1000 {}", .0.micro_unit())]
    Range(Axis),
    /// Not the address of a TCP server.
    #[error("must be HOST:PORT, the TCP server of a daemon, such as 127.0.0.1:7361")]
    Endpoint,
    /// Not a duration in the allowed range.
    #[error("must be a number of seconds from 0 to 86400")]
    Seconds,
}

/// Parses the name of an axis.
pub(super) fn axis(text: &str) -> Result<Axis, OptionError> {
    let found = Axis::ALL.into_iter().find(|axis| axis.name() == text);
    found.ok_or(OptionError::Axis)
}

/// Parses `AXIS=X`, with X in um or urad, or with a unit.
pub(super) fn interval(text: &str) -> Result<(Axis, f64), OptionError> {
    let (name, quantity) = text.split_once('=').ok_or(OptionError::Interval)?;
    let axis = axis(name)?;
    let interval = quantity::parse(axis, quantity)?;
    if interval > 0.0 && interval <= MOST {
        return Ok((axis, interval));
    }
    Err(OptionError::Range(axis))
}

/// Parses the address of the daemon's TCP server.
pub(super) fn endpoint(text: &str) -> Result<Endpoint, OptionError> {
    let full = if text.contains("://") { text.to_owned() } else { format!("tcp://{text}") };
    match full.parse() {
        Ok(endpoint @ Endpoint::Tcp(_)) => Ok(endpoint),
        _ => Err(OptionError::Endpoint),
    }
}

/// Parses the duration of the record at rest.
pub(super) fn seconds(text: &str) -> Result<f64, OptionError> {
    let seconds = text.parse().ok().filter(|s| (0.0..=86_400.0).contains(s));
    seconds.ok_or(OptionError::Seconds)
}
