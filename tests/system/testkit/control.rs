//! The control socket of a daemon, by way of `trifacet ctl`.

use std::path::PathBuf;

use serde_json::Value;

use super::{Daemon, run, trifacet, wait_for};

impl Daemon {
    pub(crate) fn socket(&self) -> PathBuf {
        self.home.path("socket")
    }

    /// What `trifacet ctl` answers: its exit code, what it prints, what it complains of.
    pub(crate) fn ctl(&self, args: &[&str]) -> (i32, Value, String) {
        let done = run(trifacet(&["ctl", "--socket"]).arg(self.socket()).args(args));
        (done.code, serde_json::from_str(&done.out).unwrap_or_default(), done.err)
    }

    /// The answer to a command that must work.
    pub(crate) fn told(&self, args: &[&str]) -> Value {
        let (code, answer, errors) = self.ctl(args);
        assert_eq!((code, &answer["ok"]), (0, &Value::Bool(true)), "{args:?}: {answer} {errors}");
        answer
    }

    /// What `trifacet ctl status` answers.
    pub(crate) fn status(&self) -> Value {
        self.told(&["status"])
    }

    /// Asks for the status until this is true of it.
    pub(crate) fn status_until(&self, is: impl Fn(&Value) -> bool) -> Value {
        wait_for("so", || {
            let status = self.status();
            if is(&status) { Ok(status) } else { Err(status.to_string()) }
        })
    }
}
