//! Results of the identification as a table and as keys of the configuration.

use std::fmt;

use trifacet::config::edit::{Edit, Value};
use trifacet::config::{CenteringConfig, Config, Gains};
use trifacet::identification::findings::{Findings, Measured};
use trifacet::identification::origin::errors_of_displaced_psd;
use trifacet::identification::plan::Plan;
use trifacet::identification::record::AXES;
use trifacet_core::steering::BeamPoint;

/// Results together with the configuration of the measurement.
pub(super) struct Report<'a> {
    pub(super) config: &'a Config,
    pub(super) plan: &'a Plan,
    pub(super) findings: &'a Findings,
}

impl Report<'_> {
    /// The keys to write.
    ///
    /// # Errors
    /// The head cannot be built.
    pub(super) fn edits(&self) -> anyhow::Result<Vec<Edit>> {
        let Findings { matrix, origin, .. } = self.findings;
        let row = |row: &[Measured; 2]| row.iter().map(|cell| rounded(cell.value, 1e5)).collect::<Value>();
        let [delay_ms, lag_ms] = self.times_ms();
        let mut edits = vec![
            Edit { section: &["steering"], key: "matrix", value: matrix.iter().map(row).collect() },
            Edit {
                section: &["steering"],
                key: "origin_um",
                value: origin.iter().map(|o| rounded(o.value * 1e6, 1e3)).collect(),
            },
            Edit { section: &["centering"], key: "loop_delay_ms", value: delay_ms.into() },
            Edit { section: &["centering"], key: "lag_ms", value: lag_ms.into() },
        ];
        if self.config.laser.power_uw.is_none() && self.findings.power > 0.0 {
            let power_uw = rounded(self.findings.power * 1e6, 1e3);
            edits.push(Edit { section: &["laser"], key: "power_uw", value: power_uw.into() });
        }
        let large = self.large_origin();
        if large || !self.config.steering.origin_verified {
            edits.push(Edit { section: &["steering"], key: "origin_verified", value: (!large).into() });
        }
        if large {
            edits.extend(self.systematic()?);
        }
        Ok(edits)
    }

    fn origin(&self) -> BeamPoint {
        BeamPoint(self.findings.origin.map(|o| o.value))
    }

    fn large_origin(&self) -> bool {
        let [x, y] = self.origin().0;
        x.hypot(y) * 1e6 > self.config.tune.origin_limit_um
    }

    /// The systematic uncertainties with a large origin: those of the configuration, or the errors that a displaced
    /// PSD would cause where these are larger.
    fn systematic(&self) -> anyhow::Result<[Edit; 2]> {
        let errors = errors_of_displaced_psd(self.config.optics()?, self.origin());
        let now = self.config.estimation.systematic();
        let micro: [f64; 6] = std::array::from_fn(|i| rounded(errors[i].max(now[i]) * 1e6, 1e3));
        let list = |part: &[f64]| part.iter().copied().collect::<Value>();
        Ok([
            Edit { section: &["estimation"], key: "systematic_um", value: list(&micro[..3]) },
            Edit { section: &["estimation"], key: "systematic_urad", value: list(&micro[3..]) },
        ])
    }

    /// Why a large origin is not simply written.
    ///
    /// # Errors
    /// The head cannot be built.
    pub(super) fn origin_doubt(&self) -> anyhow::Result<Option<String>> {
        if !self.large_origin() {
            return Ok(None);
        }
        let [x, y] = self.origin().0.map(|metres| metres * 1e6);
        let errors = errors_of_displaced_psd(self.config.optics()?, self.origin());
        let largest = |part: &[f64]| part.iter().fold(0.0_f64, |a, b| a.max(*b)) * 1e6;
        Ok(Some(format!(
            "the origin is {x:.1}, {y:.1} um; tune.origin_limit_um is {}.\n\
             Either the laser is displaced by this amount: then repeat with --accept-origin.\n\
             Or a PSD is displaced, or its dark offset is wrong: then the poses are wrong by up to {:.0} um and {:.0} \
             urad, and the origin would hide it. Check the geometry in [head] and `trifacet dark`.\n\
             Steps of the stage cannot distinguish the two; a calibration can",
            self.config.tune.origin_limit_um,
            largest(&errors[..3]),
            largest(&errors[3..])
        )))
    }

    /// Delay and lag as written, milliseconds.
    fn times_ms(&self) -> [f64; 2] {
        let Findings { delay, lag, .. } = self.findings;
        [rounded(delay.value * 1e3, 1e4).max(1e-4), rounded(lag.value * 1e3, 1e4)]
    }

    /// The gains that the daemon derives from these keys, and the relative standard uncertainty of the
    /// integral gain.
    fn gains(&self) -> (Gains, f64) {
        let [loop_delay_ms, lag_ms] = self.times_ms();
        let centering = CenteringConfig { loop_delay_ms, lag_ms, ..self.config.centering.clone() };
        let rate_hz = self.config.acquisition.rate_hz;
        let by_delay =
            centering.loop_delay_s(rate_hz) <= loop_delay_ms * 1e-3 && centering.ki_per_s.is_none();
        let Measured { value, sigma } = self.findings.delay;
        (centering.gains(rate_hz), if by_delay { sigma / value } else { 0.0 })
    }
}

impl fmt::Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Findings { matrix, origin, delay, lag, .. } = self.findings;
        for (name, row) in AXES.iter().zip(matrix) {
            let cells = row.map(|cell| format!("{:9.5} +- {:.5}", cell.value, cell.sigma));
            writeln!(f, "beam {name} per axis x, y   {}   {}", cells[0], cells[1])?;
        }
        for (name, o) in AXES.iter().zip(origin) {
            writeln!(f, "origin {name}              {:9.3} +- {:.3} um", o.value * 1e6, o.sigma * 1e6)?;
        }
        write!(f, "total power           {:9.3} uW", self.findings.power * 1e6)?;
        match self.config.laser.power_uw {
            Some(uw) => writeln!(
                f,
                ", laser.power_uw is {uw}: {:+.1} %",
                (self.findings.power * 1e6 / uw - 1.0) * 1e2
            )?,
            None => writeln!(f)?,
        }
        let ms = |m: &Measured| format!("{:9.4} +- {:.4} ms", m.value * 1e3, m.sigma * 1e3);
        let [middle, longest] = self.findings.computed.map(|s| s * 1e3);
        writeln!(
            f,
            "delay                 {}, between steps +- {:.4} ms",
            ms(delay),
            self.findings.jitter * 1e3
        )?;
        writeln!(f, "  sample to command   {middle:9.4} ms, at most {longest:.4} ms")?;
        writeln!(f, "lag                   {}", ms(lag))?;
        let [x, y] = self.findings.noise.map(|n| n * 1e6);
        writeln!(f, "noise of the offset   {x:9.4} um in x, {y:.4} um in y, per sample")?;
        for (name, readback) in AXES.iter().zip(self.findings.readback.iter().flatten()) {
            writeln!(
                f,
                "readback {name}            {:9.4} +- {:.4} of the command, {:.3} um offset, noise {:.3} um",
                readback.scale.value,
                readback.scale.sigma,
                readback.offset * 1e6,
                readback.noise * 1e6
            )?;
        }
        self.show_gains(f)?;
        for remark in &self.findings.remarks {
            writeln!(f, "note: {remark}")?;
        }
        Ok(())
    }
}

impl Report<'_> {
    fn show_gains(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let (Gains { kp, ki_per_s }, part) = self.gains();
        let lag = self.findings.lag;
        let kp_part = if lag.value > 0.0 { part.hypot(lag.sigma / lag.value) } else { 0.0 };
        writeln!(f, "gain Kp               {kp:9.4} +- {:.4}", kp * kp_part)?;
        writeln!(f, "gain Ki               {ki_per_s:9.2} +- {:.2} /s", ki_per_s * part)?;
        let behind = 1e3 / ki_per_s;
        writeln!(
            f,
            "following error       {behind:9.3} +- {:.3} um per mm/s, without feed-forward",
            behind * part
        )?;
        let shortest = 2e3 / self.config.acquisition.rate_hz;
        let centering = &self.config.centering;
        if self.times_ms()[0] < shortest && centering.ki_per_s.is_none() {
            writeln!(
                f,
                "note: the gains are those for a delay of {shortest} ms: a sampled loop has at least two periods"
            )?;
        }
        let given = [("kp", centering.kp), ("ki_per_s", centering.ki_per_s)];
        for (key, value) in given.into_iter().filter_map(|(key, value)| Some((key, value?))) {
            writeln!(
                f,
                "note: the configuration sets centering.{key} = {value}, which overrides the value from delay and lag"
            )?;
        }
        let mm = self.plan.step * 1e6;
        let used = self.findings.responses.each_ref().map(|r| r.used);
        writeln!(f, "measured with {} and {} steps of {mm:.3} um", used[0], used[1])
    }
}

/// Rounded to one part in `parts`, without a negative zero.
fn rounded(x: f64, parts: f64) -> f64 {
    (x * parts).round() / parts + 0.0
}
