//! Where the pose of each point comes from.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::PathBuf;

use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;
use tokio::sync::{mpsc, oneshot};
use trifacet::acquisition::Source;
use trifacet::calibration::bench::Bench;
use trifacet::calibration::effort::ReferenceNoise;
use trifacet::core::time::Clock;
use trifacet::exit::{self, Failure};
use trifacet::twin::{MirrorMove, MoveRequest};
use trifacet_optics::calibration::plan::Planned;

use super::answer::{Unit, parse};
use super::lines::{self, Line};
use super::{RunArgs, program};

/// Largest mean velocity of the twin's mirror, metres and radians per second; the loop follows it.
const SPEED: [f64; 2] = [2e-3, 10e-3];
/// Shortest time of a move of the twin's mirror, seconds.
const SHORTEST_S: f64 = 0.1;

/// The kinds of reference.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum ReferenceKind {
    /// The operator moves the mirror.
    Manual,
    /// A file that grows.
    File(PathBuf),
    /// A pipe.
    Pipe(PathBuf),
    /// A program.
    Command,
    /// The mirror of the twin.
    Twin,
}

/// Parses `--reference`.
pub(super) fn kind(text: &str) -> Result<ReferenceKind, &'static str> {
    match text.split_once(':') {
        Some(("file", path)) if !path.is_empty() => Ok(ReferenceKind::File(path.into())),
        Some(("pipe", path)) if !path.is_empty() => Ok(ReferenceKind::Pipe(path.into())),
        None if text == "manual" => Ok(ReferenceKind::Manual),
        None if text == "command" => Ok(ReferenceKind::Command),
        None if text == "twin" => Ok(ReferenceKind::Twin),
        _ => Err("allowed are manual, file:PATH, pipe:PATH, command (with -- PROGRAM ARG...), twin"),
    }
}

/// A reference.
pub(super) enum Reference {
    /// See [`ReferenceKind`].
    Manual(mpsc::UnboundedReceiver<Line>),
    /// Lines that answer the points: by their order in a file, or one after the other.
    Lines(Answers),
    /// The program and its time limit.
    Command(Vec<String>, f64),
    /// The twin's mirror.
    Twin(TwinMirror),
}

/// What the reference says.
pub(super) enum Said {
    /// The mirror is here; NaN: not measured. Metres and radians.
    At([f64; 6]),
    /// This point is omitted.
    Skip,
}

/// Lines of a file or a pipe.
pub(super) struct Answers {
    name: String,
    lines: mpsc::UnboundedReceiver<Line>,
    /// In a file, a line belongs to the point of the same number.
    numbered: bool,
    /// Number of lines with poses so far.
    count: u32,
    /// Lines of later points.
    waiting: BTreeMap<u32, (u64, String)>,
}

/// The mirror of the twin.
pub(super) struct TwinMirror {
    moves: mpsc::Sender<MoveRequest>,
    at: [f64; 6],
    rng: Pcg64,
    noise: ReferenceNoise,
}

impl Reference {
    /// The reference of the options, unless it is the twin.
    pub(super) fn of(args: &RunArgs, kind: &ReferenceKind) -> Result<Self, Failure> {
        let answers = |name: String, lines, numbered| {
            Self::Lines(Answers { name, lines, numbered, count: 0, waiting: BTreeMap::new() })
        };
        Ok(match kind {
            ReferenceKind::Manual => Self::Manual(lines::of_stdin()),
            ReferenceKind::File(path) => {
                answers(path.display().to_string(), lines::of_file(path.clone()), true)
            }
            ReferenceKind::Pipe(path) if path.as_os_str() == "-" => {
                answers("standard input".into(), lines::of_stdin(), false)
            }
            ReferenceKind::Pipe(path) => answers(path.display().to_string(), lines::of_pipe(path), false),
            ReferenceKind::Command => Self::Command(args.program.clone(), args.command_timeout),
            ReferenceKind::Twin => return Err(Failure::new(exit::USAGE, "the source is not the twin")),
        })
    }

    /// The mirror of the twin, which is moved through `moves`. `seed`: of the noise of the reference.
    pub(super) fn twin(moves: mpsc::Sender<MoveRequest>, seed: u64, noise: ReferenceNoise) -> Self {
        Self::Twin(TwinMirror { moves, at: [0.0; 6], rng: Pcg64::seed_from_u64(!seed), noise })
    }

    /// Whether an operator can repeat or omit a point.
    pub(super) fn is_manual(&self) -> bool {
        matches!(self, Self::Manual(_))
    }

    /// Whether the source is simulated together with the mirror.
    pub(super) fn is_twin(&self) -> bool {
        matches!(self, Self::Twin(_))
    }

    /// Asks for a pose, and returns the measured one when the mirror has arrived.
    pub(super) async fn ask<S: Source, C: Clock>(
        &mut self,
        point: u32,
        of: usize,
        planned: &Planned,
        bench: &mut Bench<S, C>,
    ) -> Result<Said, Failure> {
        match self {
            Self::Manual(lines) => ask_operator(lines, point, of, planned, bench).await,
            Self::Lines(answers) => answers.ask(point, planned, bench).await.map(Said::At),
            Self::Command(template, timeout_s) => {
                let arguments = program::arguments(template, point, planned);
                let name = arguments.first().cloned().unwrap_or_default();
                let ran = bench.wait_for(program::run(arguments, *timeout_s)).await?;
                let wrong = |e: String| Failure::new(exit::DATA, format!("point {point}: {e}"));
                let line = ran.map_err(|e| wrong(e.to_string()))?;
                let pose = parse(&line, Unit::Si);
                pose.map(Said::At).map_err(|e| wrong(format!("{name} printed \"{}\": {e}", line.trim())))
            }
            Self::Twin(mirror) => mirror.go(planned, bench).await.map(Said::At),
        }
    }
}

fn stopped() -> Failure {
    Failure::new(exit::INTERRUPTED, "stopped")
}

/// Prompts, and returns what the operator types.
async fn typed<S: Source, C: Clock>(
    lines: &mut mpsc::UnboundedReceiver<Line>,
    prompt: &str,
    bench: &mut Bench<S, C>,
) -> Result<String, Failure> {
    eprint!("{prompt}");
    let _ = io::stderr().flush(); // without the prompt, the operator cannot answer
    let ended = || Failure::new(exit::DATA, "the input has ended before the last point");
    match bench.wait_for(lines.recv()).await? {
        Some(Ok((_, line))) => Ok(line.trim().to_owned()),
        Some(Err(e)) => Err(Failure::new(exit::IO, format!("cannot read standard input: {e}"))),
        None => Err(ended()),
    }
}

async fn ask_operator<S: Source, C: Clock>(
    lines: &mut mpsc::UnboundedReceiver<Line>,
    point: u32,
    of: usize,
    planned: &Planned,
    bench: &mut Bench<S, C>,
) -> Result<Said, Failure> {
    let [tx, ty, tz, roll, pitch, yaw] = planned.pose.to_array().map(|x| x * 1e6);
    let what = if planned.tare { " (tare pose)" } else { "" };
    let prompt = format!(
        "pose {point} of {of}{what}: {tx:+.2} {ty:+.2} {tz:+.2} um, {roll:+.2} {pitch:+.2} {yaw:+.2} urad; \
         Enter when the mirror is there, or six measured numbers (um, urad), s skips, q stops: "
    );
    loop {
        match typed(lines, &prompt, bench).await?.as_str() {
            "" | "ok" => return Ok(Said::At(planned.pose.to_array())),
            "s" => return Ok(Said::Skip),
            "q" => return Err(stopped()),
            text => match parse(text, Unit::Micro) {
                Ok(pose) => return Ok(Said::At(pose)),
                Err(e) => eprintln!("point {point}: {e}"),
            },
        }
    }
}

impl Answers {
    async fn ask<S: Source, C: Clock>(
        &mut self,
        point: u32,
        planned: &Planned,
        bench: &mut Bench<S, C>,
    ) -> Result<[f64; 6], Failure> {
        let numbers = planned.pose.to_array().map(|x| format!("{x:e}")).join(",");
        let asked = format!("{},{numbers}", if planned.tare { "tare" } else { "point" });
        let mut out = io::stdout().lock();
        let closed = |e: io::Error| Failure::new(exit::IO, format!("cannot write to standard output: {e}"));
        writeln!(out, "{asked}").and_then(|()| out.flush()).map_err(closed)?;
        drop(out);
        let (number, line) = self.line(point, bench).await?;
        parse(&line, Unit::Si).map_err(|e| {
            let place = format!("{}:{number}: point {point}", self.name);
            Failure::new(exit::DATA, format!("{place}: \"{}\": {e}", line.trim()))
        })
    }

    /// The line that answers this point.
    async fn line<S: Source, C: Clock>(
        &mut self,
        point: u32,
        bench: &mut Bench<S, C>,
    ) -> Result<(u64, String), Failure> {
        loop {
            if let Some(found) = self.waiting.remove(&point).filter(|_| self.numbered) {
                return Ok(found);
            }
            let (number, line) = match bench.wait_for(self.lines.recv()).await? {
                Some(Ok(line)) => line,
                Some(Err(e)) => {
                    return Err(Failure::new(exit::IO, format!("cannot read {}: {e}", self.name)));
                }
                None => {
                    let what = format!("{} has ended before the answer to point {point}", self.name);
                    return Err(Failure::new(exit::DATA, what));
                }
            };
            if no_pose(&line) {
                continue;
            }
            if !self.numbered {
                return Ok((number, line));
            }
            self.count += 1;
            self.waiting.insert(self.count, (number, line));
        }
    }
}

/// Blank lines, comments, and a line with the names of the columns.
fn no_pose(line: &str) -> bool {
    let line = line.trim();
    line.is_empty() || line.starts_with('#') || line.contains("tx_m")
}

impl TwinMirror {
    /// Moves the mirror, and returns its pose with the noise of the reference.
    async fn go<S: Source, C: Clock>(
        &mut self,
        planned: &Planned,
        bench: &mut Bench<S, C>,
    ) -> Result<[f64; 6], Failure> {
        let to = planned.pose.to_array();
        let way = (0..6).map(|i| (to[i] - self.at[i]).abs() / SPEED[i / 3]).fold(SHORTEST_S, f64::max);
        let (done, arrived) = oneshot::channel();
        let asked = MirrorMove { micro: to.map(|x| x * 1e6), over_s: way };
        let gone = || Failure::new(exit::SOFTWARE, "the twin is gone");
        self.moves.try_send((asked, done)).map_err(|_| gone())?;
        bench.run_until(arrived).await?.map_err(|_| gone())?;
        self.at = to;
        let sigmas = self.noise.of_pose();
        let failed = |e: rand_distr::NormalError| Failure::new(exit::SOFTWARE, e.to_string());
        let mut pose = to;
        for (x, sigma) in pose.iter_mut().zip(sigmas) {
            *x += Normal::new(0.0, sigma).map_err(failed)?.sample(&mut self.rng);
        }
        Ok(pose)
    }
}
