//! Python with packages that are installed once under `target/`.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The Python of a virtual environment with these modules. The environment is made from these packages if it
/// is missing.
pub(crate) fn python(name: &str, modules: &str, packages: &[&str]) -> PathBuf {
    let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let python = place.join("bin/python");
    // Tests run in parallel; one of them makes the environment for all.
    let lock = File::create(place.with_extension("lock")).expect("a lock file");
    lock.lock().expect("a lock");
    let has_all = |python: &Path| {
        let check = Command::new(python).args(["-c", &format!("import {modules}")]).output();
        check.is_ok_and(|o| o.status.success())
    };
    if !has_all(&python) {
        let what =
            format!("{modules} cannot be installed for the tests (python3-venv and a network are needed)");
        succeeded(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&place), &what);
        succeeded(Command::new(&python).args(["-m", "pip", "install", "--quiet"]).args(packages), &what);
    }
    python
}

/// Runs a program that must succeed.
pub(crate) fn succeeded(command: &mut Command, what: &str) -> Output {
    let output = command.output().unwrap_or_else(|e| panic!("{what}: {e}"));
    assert!(
        output.status.success(),
        "{what}: {}\n{}{}",
        output.status,
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    output
}
