//! The program that moves a stage: run for each pose, as a list of arguments and without a shell.

use std::os::unix::process::CommandExt as _;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process_group};
use tokio::sync::oneshot;
use tokio::time::sleep;
use trifacet_optics::calibration::plan::Planned;
use trifacet_wire::layout::POSE;

/// Most characters of the program's own message in an error.
const MESSAGE: usize = 300;

/// Why the program gave no pose.
#[derive(Debug, thiserror::Error)]
pub(super) enum ProgramError {
    /// It cannot be started.
    #[error("cannot run {program}: {reason}")]
    Start {
        /// Its path.
        program: String,
        /// The error of the system.
        reason: std::io::Error,
    },
    /// It failed.
    #[error("{program} ended with {status}{message}")]
    Failed {
        /// Its path.
        program: String,
        /// How it ended.
        status: std::process::ExitStatus,
        /// The end of its standard error.
        message: String,
    },
    /// It runs too long.
    #[error("{program} has not ended after {seconds} s (--command-timeout), and was ended")]
    Timeout {
        /// Its path.
        program: String,
        /// The time limit.
        seconds: f64,
    },
    /// It printed nothing.
    #[error("{program} printed nothing on standard output")]
    Silent {
        /// Its path.
        program: String,
    },
}

/// The arguments with the values of this point.
pub(super) fn arguments(template: &[String], point: u32, planned: &Planned) -> Vec<String> {
    let kind = if planned.tare { "tare" } else { "point" };
    let mut values = vec![("{point}".to_owned(), point.to_string()), ("{kind}".to_owned(), kind.to_owned())];
    let pose = POSE.iter().zip(planned.pose.to_array());
    values.extend(pose.map(|(name, x)| (format!("{{{name}}}"), format!("{x:e}"))));
    let fill =
        |text: &String| values.iter().fold(text.clone(), |text, (name, value)| text.replace(name, value));
    template.iter().map(fill).collect()
}

/// Ends the process group of the program unless it has ended by itself.
struct Running(Option<Pid>);

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(pid) = self.0 {
            let _ = kill_process_group(pid, Signal::TERM); // it may have ended just now
        }
    }
}

/// Runs the program, and returns the last line that it prints. If the future is dropped, the program is ended.
pub(super) async fn run(arguments: Vec<String>, timeout_s: f64) -> Result<String, ProgramError> {
    let program = arguments.first().cloned().unwrap_or_default();
    // A group of its own: Ctrl-C ends the measurement in order, and the program with it.
    let spawned = Command::new(&program)
        .args(arguments.get(1..).unwrap_or_default())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .process_group(0)
        .spawn();
    let child = spawned.map_err(|reason| ProgramError::Start { program: program.clone(), reason })?;
    let mut running = Running(Pid::from_raw(child.id() as i32));
    let (done, ended) = oneshot::channel();
    std::thread::spawn(move || {
        let _ = done.send(child.wait_with_output()); // nobody waits after an interruption
    });
    let output = tokio::select! {
        output = ended => output,
        () = sleep(Duration::from_secs_f64(timeout_s)) => {
            return Err(ProgramError::Timeout { program, seconds: timeout_s });
        }
    };
    running.0 = None;
    match output {
        Ok(Ok(output)) => last_line(program, &output),
        Ok(Err(reason)) => Err(ProgramError::Start { program, reason }),
        Err(_) => Err(ProgramError::Silent { program }),
    }
}

fn last_line(program: String, output: &Output) -> Result<String, ProgramError> {
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let last = said.trim().lines().last().unwrap_or_default();
        let message = if last.is_empty() { String::new() } else { format!(": {}", shortened(last)) };
        return Err(ProgramError::Failed { program, status: output.status, message });
    }
    let printed = String::from_utf8_lossy(&output.stdout);
    let last = printed.lines().rev().find(|line| !line.trim().is_empty());
    last.map(str::to_owned).ok_or(ProgramError::Silent { program })
}

fn shortened(text: &str) -> String {
    text.chars().take(MESSAGE).collect()
}
