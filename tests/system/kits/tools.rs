//! The programs that the kits are made for. A missing program fails the test, which could test nothing
//! without it.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use tempfile::TempDir;

use crate::testkit::venv;
pub(crate) use crate::testkit::venv::succeeded;

/// A file of the repository.
pub(crate) fn root(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The text of a file of the repository.
pub(crate) fn read(path: &str) -> String {
    std::fs::read_to_string(root(path)).unwrap()
}

/// Python with the module of the kit and only the standard library.
pub(crate) fn python(script: &str) -> Command {
    python_of("clients/python", script)
}

/// The same with the module of another folder.
pub(crate) fn python_of(kit: &str, script: &str) -> Command {
    need("python3", "it runs the Python kit");
    let mut command = Command::new("python3");
    for_python(&mut command).env("PYTHONPATH", root(kit)).args(["-W", "error"]).arg(root(script));
    command
}

fn for_python(command: &mut Command) -> &mut Command {
    command.env("PYTHONPATH", root("clients/python")).env("PYTHONDONTWRITEBYTECODE", "1")
}

/// Python with NumPy and a parser for the Structured Text of TwinCAT, installed once under `target/`.
pub(crate) fn python_with_packages() -> Command {
    static VENV: OnceLock<PathBuf> = OnceLock::new();
    let python = VENV.get_or_init(|| {
        need("python3", "it runs the Python kit");
        venv::python("kits-venv", "numpy, blark", &["numpy", "blark==0.8.3"])
    });
    let mut command = Command::new(python);
    for_python(&mut command);
    command
}

/// Compiles a C program with the strictest warnings that its users may choose. `more` are options, libraries and
/// further sources.
pub(crate) fn compile(source: &str, more: &[&str]) -> (TempDir, PathBuf) {
    need("cc", "it compiles the C kit");
    let place = tempfile::tempdir().unwrap();
    let program = place.path().join("program");
    let strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-O2", "-I"];
    let mut command = Command::new("cc");
    command.args(strict).arg(root("clients/c")).arg("-o").arg(&program).arg(root(source)).args(more);
    succeeded(&mut command, source);
    (place, program)
}

fn need(program: &str, why: &str) {
    let found = Command::new(program).arg("--version").output();
    assert!(found.is_ok(), "{program} is not installed: {why}");
}
