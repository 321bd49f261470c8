//! The program as a command.

use std::path::Path;
use std::process::{Child, Command, Stdio};

use super::turn::Turn;

/// Instead of `$XDG_RUNTIME_DIR`: daemons of several tests must not share a control socket.
pub(crate) const NO_SESSION: &str = "/nonexistent";

/// The result of a command.
#[derive(Debug)]
pub(crate) struct Done {
    pub(crate) code: i32,
    pub(crate) out: String,
    pub(crate) err: String,
}

/// The program with these arguments and an empty standard input.
pub(crate) fn trifacet(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trifacet"));
    command.args(args).stdin(Stdio::null()).env("XDG_RUNTIME_DIR", NO_SESSION);
    command
}

/// Runs the program with these arguments, for which it computes for seconds, and waits for its end. The daemons of other
/// tests come first.
pub(crate) fn computing(args: &[&str]) -> Done {
    let _turn = Turn::wait();
    run(Command::new("nice").arg(env!("CARGO_BIN_EXE_trifacet")).args(args).stdin(Stdio::null()))
}

/// Runs a command and waits for its end.
pub(crate) fn run(command: &mut Command) -> Done {
    let output = command.output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    let code = output.status.code().unwrap_or_else(|| panic!("{command:?} ended with {}", output.status));
    Done { code, out: text(output.stdout), err: text(output.stderr) }
}

/// Runs the program with a file as its last argument.
pub(crate) fn on(args: &[&str], file: &Path) -> Done {
    run(trifacet(args).arg(file))
}

/// Whether something that a test needs is absent; the test is then skipped, except in `.ci/run`.
pub(crate) fn lacks(present: bool, what: &str) -> bool {
    assert!(present || std::env::var_os("CI").is_none(), "this test needs {what}");
    !present
}

/// A child process that is killed at the end of its test.
pub(crate) struct Killed(pub(crate) Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
