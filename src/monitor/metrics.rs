//! The page `/metrics`. The table in docs/monitoring.md lists its contents; a test compares both.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use prometheus_client::collector::Collector;
use prometheus_client::encoding::text::encode;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric, MetricEncoder};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::Registry;
use rustix::time::{ClockId, clock_gettime};
use trifacet_core::centering::lock::LockCause;
use trifacet_core::telemetry::{Counters, Drift};
use trifacet_core::time::Clock;
use trifacet_wire::{LockState, Status};

use super::exposition::Exposition;
use super::tally::{Second, Tally};
use super::view::View;
use crate::clock::SystemClock;
use crate::doubts::Subject;
use crate::publishing::udp::Kind;

const PSDS: [&str; 3] = ["A", "B", "C"];

/// Renders the page in a format.
///
/// # Errors
/// A metric cannot be formatted.
pub fn render(view: Arc<View>, format: Exposition) -> Result<String, fmt::Error> {
    let mut registry = Registry::with_prefix("trifacet");
    registry.register_collector(Box::new(view));
    let mut text = String::new();
    encode(&mut text, &registry)?;
    Ok(format.of(text))
}

impl Collector for View {
    fn encode(&self, encoder: DescriptorEncoder) -> fmt::Result {
        let mut page = Page(encoder);
        page.daemon(self)?;
        page.clients(self)?;
        let counters = &self.sources.condition.counters;
        for ((name, count), definition) in counters.list().into_iter().zip(Counters::DEFINITIONS) {
            page.put(name, definition.meaning.trim_end_matches('.'), &ConstCounter::new(count))?;
        }
        let causes = LockCause::ALL
            .iter()
            .map(|cause| (cause.label(), ConstCounter::new(counters.lock_cause(*cause).get())));
        page.each("lock_changes", "Changes of the lock state, by cause", "cause", causes)?;
        page.state(self)?;
        page.commands(self)?;
        page.doubts(self)?;
        page.recording(self)?;
        let aggregates = self.aggregates();
        page.frames(&aggregates.tally)?;
        page.second(&aggregates.tally.second)?;
        let trend = aggregates.tally.trend.per_second();
        page.known(
            "power_trend_watts_per_second",
            "Slope of the total power over the last ten minutes",
            trend,
        )
    }
}

struct Page<'a>(DescriptorEncoder<'a>);

impl Page<'_> {
    fn put(&mut self, name: &str, help: &str, metric: &impl EncodeMetric) -> fmt::Result {
        metric.encode(self.0.encode_descriptor(name, help, None, metric.metric_type())?)
    }

    fn gauge(&mut self, name: &str, help: &str, value: f64) -> fmt::Result {
        self.put(name, help, &ConstGauge::new(value))
    }

    /// A gauge that is absent while its value is unknown. Zero would be misleading.
    fn known(&mut self, name: &str, help: &str, value: Option<f64>) -> fmt::Result {
        value.map_or(Ok(()), |value| self.gauge(name, help, value))
    }

    /// One metric for each value of a label. Unknown ones are absent.
    fn each<M: EncodeMetric>(
        &mut self,
        name: &str,
        help: &str,
        label: &'static str,
        metrics: impl IntoIterator<Item = (&'static str, M)>,
    ) -> fmt::Result {
        let mut metrics = metrics.into_iter().peekable();
        let Some((_, first)) = metrics.peek() else { return Ok(()) };
        let mut family: MetricEncoder = self.0.encode_descriptor(name, help, None, first.metric_type())?;
        metrics.try_for_each(|(value, metric)| metric.encode(family.encode_family(&[(label, value)])?))
    }

    fn daemon(&mut self, view: &View) -> fmt::Result {
        let version = [("version", env!("CARGO_PKG_VERSION"))];
        self.0
            .encode_descriptor("build", "Version of the running program", None, MetricType::Info)?
            .encode_info(&version)?;
        let cpu = clock_gettime(ClockId::ProcessCPUTime);
        let cpu_s = cpu.tv_sec as f64 + cpu.tv_nsec as f64 * 1e-9;
        self.put("process_cpu_seconds", "CPU time of all threads", &ConstCounter::new(cpu_s))?;
        self.known("process_resident_memory_bytes", "Resident memory", resident_bytes())?;
        let rate_hz = view.sources.config.borrow().acquisition.rate_hz;
        self.gauge("sample_rate_hertz", "Configured number of samples per second", rate_hz)
    }

    fn clients(&mut self, view: &View) -> fmt::Result {
        let counters = &view.sources.condition.counters;
        let tcp = counters.tcp_connected.get().saturating_sub(counters.tcp_disconnected.get());
        let receivers = view.sources.condition.receivers.borrow().clone();
        let udp = receivers.iter().filter(|receiver| receiver.kind == Kind::Subscriber).count();
        let clients = [("tcp", tcp), ("udp", udp as u64), ("page", view.viewers() as u64)];
        let gauges = clients.map(|(kind, n)| (kind, ConstGauge::new(n)));
        self.each("clients", "TCP clients, subscribers to datagrams, viewers of the page", "kind", gauges)?;
        let failing = receivers.iter().filter(|receiver| receiver.failing.is_some()).count();
        let states = [("working", receivers.len() - failing), ("failing", failing)];
        let gauges = states.map(|(state, n)| (state, ConstGauge::new(n as u64)));
        self.each(
            "udp_receivers",
            "Receivers of datagrams, targets and subscribers, by state",
            "state",
            gauges,
        )
    }

    /// The present state.
    fn state(&mut self, view: &View) -> fmt::Result {
        let readiness = view.readiness();
        let checks = readiness.checks.iter().map(|check| (check.name, flag(check.ok)));
        self.each("ready", "1 if the check of /readyz passes", "check", checks)?;
        let silent = view.dead().is_some_and(|still| still.silent);
        let lock = view.newest().borrow().filter(|_| !silent).map(|newest| newest.frame.lock);
        let of = |lock| LockState::ALL.map(|state| (state.name(), flag(lock == state)));
        let states = lock.into_iter().flat_map(of);
        self.each("lock_state", "1 for the current state of the loop", "state", states)?;
        let of = |cause| LockCause::ALL.iter().map(move |each| (each.label(), flag(*each == cause)));
        let causes = view.lock().filter(|_| !silent).into_iter().flat_map(|now| of(now.cause));
        self.each("lock_cause", "1 for the cause of the current state of the loop", "cause", causes)
    }

    fn commands(&mut self, view: &View) -> fmt::Result {
        let backlog = view.sources.commands.backlog();
        let count = f64::from(backlog.count);
        self.gauge("commands_unanswered", "Steering commands without an acknowledgement", count)?;
        let help = "Age of the oldest steering command without an acknowledgement, 0 if all are acknowledged";
        self.gauge("command_age_seconds", help, backlog.age_s(SystemClock.now()))?;
        let help =
            "Median time from a sample to the first scan in which its command is applied, without the stage";
        self.known("command_delay_seconds", help, view.sources.commands.delay_s())?;
        let config = view.sources.config.borrow();
        let delay_s = config.centering.loop_delay_s(config.acquisition.rate_hz);
        self.gauge("loop_delay_seconds", "Configured loop delay, which the gains are derived from", delay_s)
    }

    fn doubts(&mut self, view: &View) -> fmt::Result {
        let doubts = &view.sources.condition.doubts;
        let states = Subject::ALL.map(|subject| (subject.name(), flag(doubts.stands(subject))));
        self.each("doubt", "1 while there is a doubt about this subject", "subject", states)?;
        let mean = doubts.residual.mean();
        let axes = ["x", "y"].into_iter().zip(mean.into_iter().flatten().map(ConstGauge::new));
        let help = "Beam position by the readback minus that by the light, mean over about a second";
        self.each("steering_residual_mean_meters", help, "axis", axes)?;
        self.drift(&doubts.drift.get())
    }

    /// What has changed since the calibration.
    fn drift(&mut self, drift: &Drift) -> fmt::Result {
        let axes = ["x", "y"].into_iter().zip(drift.residual.into_iter().flatten().map(ConstGauge::new));
        let help = "Steering residual less that of the calibration, mean over about ten seconds";
        self.each("calibration_residual_drift_meters", help, "axis", axes)?;
        let help = "Size of this difference beyond which it is doubted";
        self.known("calibration_residual_drift_limit_meters", help, drift.limit)?;
        let psds = ["B", "C"].into_iter().zip(drift.power_gains.into_iter().flatten().map(ConstGauge::new));
        let help =
            "Relative change of the power gain against that of PSD A which would explain this difference";
        self.each("calibration_power_gain_drift_ratio", help, "psd", psds)?;
        let psds = ["A", "B", "C"].into_iter().zip(drift.dark.into_iter().flatten().map(ConstGauge::new));
        let help = "Dark reading of the sum less that of the calibration, part of the usual power";
        self.each("calibration_dark_drift_ratio", help, "psd", psds)
    }

    fn recording(&mut self, view: &View) -> fmt::Result {
        let state = &view.sources.recording;
        let on = |flag: &AtomicBool| f64::from(u8::from(flag.load(Ordering::Relaxed)));
        self.gauge("recording", "1 while a recording is being written", on(&state.recording))?;
        self.gauge("recording_fault", "1 while the recorder loses data", on(&state.fault))?;
        let ring = state.ring.load(Ordering::Relaxed);
        self.gauge("recording_ring_bytes", "Memory used for the data before a fault", ring as f64)?;
        let free = state.free().map(|free| free as f64);
        self.known("recording_free_bytes", "Free space for recordings", free)
    }

    /// Totals over all frames.
    fn frames(&mut self, tally: &Tally) -> fmt::Result {
        let bits = Status::NAMES.iter().zip(tally.status).map(|((_, name), n)| (*name, ConstCounter::new(n)));
        self.each("status_frames", "Pose frames with this status bit", "bit", bits)?;
        let states = LockState::ALL.map(LockState::name).into_iter();
        let states = states.zip(tally.lock.map(ConstCounter::new));
        self.each("lock_frames", "Pose frames in this state of the loop", "state", states)?;
        let mut histogram = |name, help, histogram: &Histogram| self.put(name, help, histogram);
        histogram("solve_delay_seconds", "Time from the sample to the solved pose", &tally.solve_delay)?;
        histogram("send_delay_seconds", "Time from the solved pose to its transmission", &tally.send_delay)?;
        histogram("solver_iterations", "Iterations of the solver, in frames in which it ran", &tally.steps)?;
        histogram("beam_distance_meters", "Distance of the beam's centre from the apex", &tally.offset)
    }

    /// Means of the last second.
    fn second(&mut self, second: &Second) -> fmt::Result {
        let axes = ["x", "y"].into_iter().zip(second.offset.into_iter().flatten().map(ConstGauge::new));
        self.each("beam_offset_meters", "Beam's centre minus apex, mean of the last second", "axis", axes)?;
        let help = "Distance of the beam's centre from the apex, rms of the last second";
        self.known("beam_offset_rms_meters", help, second.offset_rms)?;
        let distances = PSDS.into_iter().zip(second.edge);
        let distances = distances.filter_map(|(psd, edge)| Some((psd, ConstGauge::new(edge?))));
        self.each(
            "psd_edge_distance_meters",
            "Smallest edge distance of a spot, last second",
            "psd",
            distances,
        )?;
        let psds = |numbers: Option<[f64; 3]>| {
            PSDS.into_iter().zip(numbers.into_iter().flatten().map(ConstGauge::new))
        };
        self.each("psd_power_watts", "Mean power of the last second", "psd", psds(second.powers))?;
        let total = second.powers.map(|powers| powers.iter().sum());
        self.known("power_watts", "Mean total power of the last second", total)?;
        let shares = second.lit.map(|lit| lit.map(|power| power / lit.iter().sum::<f64>()));
        self.each("psd_power_ratio", "Share of total power while all PSDs have light", "psd", psds(shares))
    }
}

fn flag(on: bool) -> ConstGauge<u64> {
    ConstGauge::new(on.into())
}

/// Resident memory in bytes. The kernel reports it in kB.
fn resident_bytes() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let kb = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    kb.trim().strip_suffix(" kB")?.parse::<f64>().ok().map(|kb| kb * 1024.0)
}
