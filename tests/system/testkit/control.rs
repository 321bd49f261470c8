//! The control socket of a daemon, through `trifacet ctl`.

use std::path::PathBuf;

use serde_json::Value;

use super::{Daemon, run, trifacet, wait_for};

impl Daemon {
    pub(crate) fn socket(&self) -> PathBuf {
        self.home.path("socket")
    }

    /// Runs `trifacet ctl`: returns its exit code, its answer and its error output.
    pub(crate) fn ctl(&self, args: &[&str]) -> (i32, Value, String) {
        let done = run(trifacet(&["ctl", "--socket"]).arg(self.socket()).args(args));
        (done.code, serde_json::from_str(&done.out).unwrap_or_default(), done.err)
    }

    /// The answer to a command that must succeed.
    pub(crate) fn told(&self, args: &[&str]) -> Value {
        let (code, answer, errors) = self.ctl(args);
        assert_eq!((code, &answer["ok"]), (0, &Value::Bool(true)), "{args:?}: {answer} {errors}");
        answer
    }

    /// The answer of `trifacet ctl status`.
    pub(crate) fn status(&self) -> Value {
        self.told(&["status"])
    }

    /// Requests the status until it fulfils this condition.
    pub(crate) fn status_until(&self, is: impl Fn(&Value) -> bool) -> Value {
        wait_for("so", || {
            let status = self.status();
            if is(&status) { Ok(status) } else { Err(status.to_string()) }
        })
    }
}
