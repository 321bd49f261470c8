//! `trifacet check`: explains a configuration.

mod recording;
mod steering;

use std::fmt::Write as _;
use std::io::Write as _;

use jiff::Timestamp;
use trifacet::config::CalibrationState;
use trifacet::config::{
    AcquisitionConfig, BoardPlace, CalibrationContext, Config, Destination, FacetConfig, FramesConfig, Host,
    LogFormat, SourceKind, SteeringKind, TransformConfig, TwinConfig,
};
use trifacet::exit::{self, Failure};
use trifacet::publishing::columns::rfc3339;
use trifacet::publishing::udp::resolve;
use trifacet::replay::RecordingHeader;
use trifacet::twin::Twin;
use trifacet_core::centering::LoopMode;
use trifacet_optics::covariance::sigmas;
use trifacet_optics::{BeamPosition, Estimator, FACETS, Innovation, Model, Noise, Pose, Signals, Vec2};

use super::{ConfigArg, written};

/// Options of `check`.
#[derive(Debug, clap::Args)]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    config: ConfigArg,
}

/// Prints the meaning of a configuration, or fails with its errors.
pub(crate) fn check(args: &CheckArgs) -> anyhow::Result<()> {
    let config = args.config.load_any_beam()?;
    let header = RecordingHeader::of_source(&config)?;
    let (config, id, calibration) = match &header {
        None => {
            let context = CalibrationContext::read(config)?; // the files that the configuration names are part of it
            let id = context.id();
            (context.config, id, context.calibration)
        }
        Some(then) => {
            then.context.config.channels(&then.context.tables)?;
            (then.holding(&config), then.context.id(), then.context.calibration.clone())
        }
    };
    if config.acquisition.source == SourceKind::Twin {
        Twin::new(&config).map_err(|error| Failure::new(exit::CONFIG, error.to_string()))?;
    }
    let mut lines = Lines::default();
    let name = args.config.config.as_ref().map_or("defaults".into(), |file| file.display().to_string());
    lines.say("configuration", format!("{name}: valid, id {id:08x}"));
    head(&config, &mut lines)?;
    if let Some(record) = calibration.describe(Timestamp::now(), config.calibration.expires_days) {
        lines.say("calibration", record);
    }
    source(&config, &mut lines);
    if let Some(then) = &header {
        lines.say(
            "",
            format!("recorded {}; id, head, channels, estimation and frames", rfc3339(then.first.1)),
        );
        lines.say("", "are taken from its beginning; these sections of the file are not used");
    }
    steering::centering(&config, &mut lines);
    steering::stage(&config, &mut lines);
    estimation(&config, &mut lines)?;
    frames(&config, &mut lines);
    publishing(&config, &mut lines);
    recording::recording(&config, &mut lines);
    machine(&config, &mut lines);
    notes(&config, &calibration, &mut lines);
    recording::note(&config, &mut lines);
    written(std::io::stdout().write_all(lines.0.as_bytes()))
}

/// Lines of output, each with a subject. The subject is printed in its first line only.
#[derive(Default)]
struct Lines(String);

impl Lines {
    fn say(&mut self, subject: &str, what: impl AsRef<str>) {
        let _ = writeln!(self.0, "{subject:<14} {}", what.as_ref()); // writing to a String cannot fail
    }
}

fn head(config: &Config, lines: &mut Lines) -> anyhow::Result<()> {
    let head = &config.head;
    let calibrated =
        head.beam_direction.is_some() || head.facets().iter().any(|f| **f != FacetConfig::default());
    lines.say(
        "head",
        format!(
            "PSDs of {} mm at {} mm, facets at {} deg, beam {} mm across{}",
            head.psd_size_mm,
            head.psd_distance_mm,
            head.facet_angle_deg,
            (head.beam_diameter_mm * 1e4).round() / 1e4,
            if calibrated { "; some parts calibrated" } else { "" }
        ),
    );
    let rest = config.optics()?.trace(Model::Gaussian, &Pose::default(), Vec2::zeros())?;
    for (i, name) in FACETS.iter().enumerate() {
        let (u, v) = (rest.spots[2 * i] * 1e3, rest.spots[2 * i + 1] * 1e3);
        let subject = if i == 0 { "light at rest" } else { "" };
        // Adding zero turns -0.0 into 0.0.
        let [u, v] = [u, v].map(|x| (x * 1e4).round() / 1e4 + 0.0);
        lines.say(
            subject,
            format!("{name}: u {u:.4} mm, v {v:.4} mm, {:.2} % of the beam", rest.powers[i] * 100.0),
        );
    }
    Ok(())
}

fn source(config: &Config, lines: &mut Lines) {
    let acquisition = &config.acquisition;
    let rate = acquisition.rate_hz;
    lines.say(
        "source",
        match acquisition.source {
            SourceKind::Twin => format!(
                "digital twin (simulated light), {rate} Hz, {} motions, {} faults, seed {}",
                config.twin.motion.len(),
                config.twin.fault.len(),
                config.twin.seed
            ),
            SourceKind::Replay => format!(
                "recording {}, {rate} Hz, {} times as fast as recorded{}",
                config.replay.file.display(),
                config.replay.speed,
                if config.replay.repeat { ", repeated" } else { "" }
            ),
            SourceKind::Board | SourceKind::Serial => board(acquisition),
            SourceKind::Labjack => format!(
                "LabJack T7 at {}, ports {} and {}, {} inputs of +-{} V, {rate} Hz",
                acquisition.labjack.address,
                acquisition.labjack.port,
                acquisition.labjack.stream_port,
                acquisition.labjack.channels().len(),
                acquisition.labjack.range_v
            ),
        },
    );
    if acquisition.source == SourceKind::Twin {
        twin(&config.twin, lines);
    }
}

fn board(acquisition: &AcquisitionConfig) -> String {
    let rate = acquisition.rate_hz;
    match acquisition.board() {
        Some(place @ BoardPlace::Serial { baud, .. }) => {
            format!("serial board at {place}, {baud} baud, {rate} Hz")
        }
        Some(place) => format!("board at {place}, {rate} Hz"),
        None => "a board without a place".into(), // no such configuration is valid
    }
}

/// Whether the head of the twin is another one than the estimator believes.
fn twin(twin: &TwinConfig, lines: &mut Lines) {
    if let Some(tolerances) = &twin.tolerances {
        let seed = tolerances.seed;
        lines.say("", format!("with a head of its own, which the estimator does not know: seed {seed}"));
    } else if twin.has_own_head() {
        lines.say("", "with a head of its own, which the estimator does not know");
    }
    if let Some(temperature) = &twin.temperature {
        let (warm_up, swing) = (temperature.warm_up_k, temperature.swing_k);
        lines.say("", format!("its temperature rises by {warm_up} K and swings by +-{swing} K"));
    }
}

fn estimation(config: &Config, lines: &mut Lines) -> anyhow::Result<()> {
    let estimation = &config.estimation;
    let model: Model = estimation.model.into();
    let of = match model {
        Model::Ray => "ray model, six signals",
        Model::Gaussian if estimation.fuse_steering => "Gaussian beam, eleven signals",
        Model::Gaussian => "Gaussian beam, nine signals",
    };
    let average = match estimation.average {
        1 => "every sample".into(),
        n => format!("means of {n} samples"),
    };
    lines.say("estimation", format!("{of}, {average}"));
    let optics = config.optics()?;
    let rest = optics.trace(Model::Gaussian, &Pose::default(), Vec2::zeros())?;
    let estimator = Estimator::new(optics, model);
    let solution = estimator.solve(&Signals { spots: rest.spots, powers: rest.powers }, None)?;
    let quieter = f64::from(estimation.average).sqrt();
    let noise = Noise {
        spots: [estimation.spot_noise_um * 1e-6 / quieter; 6],
        powers: rest.powers.map(|power| power * estimation.power_noise / quieter),
    };
    let spread = estimator.sensitivity(&solution)?.spread(&noise);
    let beam_position = BeamPosition { at: Vec2::zeros(), sigma: config.steering.beam_sigma_um() * 1e-6 };
    let innovation = Innovation::new(estimator.optics(), &solution, &spread, &beam_position);
    let covariance = innovation
        .filter(|_| estimation.fuse_steering)
        .map_or(spread.pose_covariance(), |innovation| innovation.fuse(&solution).spread.pose_covariance());
    let sigma = sigmas(&covariance) * 1e6;
    lines.say(
        "uncertainties",
        format!(
            "tx {:.3} ty {:.3} tz {:.3} um, roll {:.3} pitch {:.3} yaw {:.3} urad (standard, mirror at rest)",
            sigma[0], sigma[1], sigma[2], sigma[3], sigma[4], sigma[5]
        ),
    );
    if let Some(innovation) = innovation.filter(|_| model == Model::Gaussian) {
        steering::residual(config, &innovation, lines);
    }
    Ok(())
}

/// Frames that are the identity are not listed.
fn frames(config: &Config, lines: &mut Lines) {
    let FramesConfig { base, tool, tare } = config.frames;
    let mut subject = "frames";
    for (name, transform) in [("base", base), ("tool", tool), ("tare", tare)] {
        if transform != TransformConfig::default() {
            let TransformConfig { translation_mm: t, rotation_deg: r } = transform;
            lines.say(subject, format!("{name} at {t:?} mm, roll, pitch, yaw {r:?} deg"));
            subject = "";
        }
    }
}

fn publishing(config: &Config, lines: &mut Lines) {
    let publishing = &config.publishing;
    let rate = config.acquisition.rate_hz / f64::from(config.estimation.average);
    let tcp = match publishing.tcp {
        Some(address) => format!("TCP at {address} for {} clients", publishing.tcp_clients),
        None => "no TCP".into(),
    };
    let udp: Vec<_> = publishing.udp.iter().map(|target| resolved(&target.address)).collect();
    let udp = if udp.is_empty() { "no UDP".into() } else { format!("UDP to {}", udp.join(", ")) };
    lines.say("publishing", format!("{rate} frames per second: {tcp}; {udp}"));
    if let Some(address) = publishing.subscribe {
        lines.say("publishing", format!("subscriptions at {address} for {}", publishing.subscribers));
    }
    let allow: Vec<_> = publishing.allow.iter().map(ToString::to_string).collect();
    lines.say(
        "publishing",
        format!("clients from {}", if allow.is_empty() { "no host".into() } else { allow.join(", ") }),
    );
}

/// A target; for a name or a zone, with the present address.
fn resolved(destination: &Destination) -> String {
    match (&destination.host, resolve::address(destination)) {
        (Host::Address(_), _) | (_, Err(_)) => destination.to_string(), // an error becomes a note
        (_, Ok(address)) => format!("{destination} ({})", address.ip()),
    }
}

fn machine(config: &Config, lines: &mut Lines) {
    let realtime = &config.realtime;
    let priority = match realtime.priority {
        0 => "ordinary priority".into(),
        priority => format!("SCHED_FIFO priority {priority}"),
    };
    let cpu = realtime.cpu.map_or("any CPU".into(), |cpu| format!("CPU {cpu}"));
    let memory = if realtime.lock_memory { "memory locked" } else { "memory not locked" };
    lines.say("fast thread", format!("{priority}, {cpu}, {memory}"));
    if let Some(socket) = &config.control.socket {
        let mode = config.control.mode;
        lines.say("control", format!("{}, permissions {mode:04o}", socket.display()));
    }
    let monitor = config.monitor.listen.map_or("off".into(), |address| format!("http://{address}/"));
    lines.say("monitor", monitor);
    let format = match config.log.format {
        LogFormat::Text => "text",
        LogFormat::Json => "JSON lines",
    };
    lines.say("log", format!("{}, as {format}", config.log.level));
}

/// Settings that are allowed but may have unexpected effects.
fn notes(config: &Config, calibration: &CalibrationState, lines: &mut Lines) {
    if let Some(why) = calibration.objection() {
        lines.say("note", format!("{why}: the frames carry UNCALIBRATED"));
    }
    let bare: Vec<_> = FACETS
        .iter()
        .zip(config.channels.psds())
        .filter(|(_, psd)| psd.correction.is_none())
        .map(|(name, _)| name.to_string())
        .collect();
    if !bare.is_empty() {
        let psds = bare.join(", ");
        lines.say("note", format!("no correction table for PSD {psds}: spots have errors of up to 250 um"));
    }
    if !config.steering.origin_verified {
        lines.say("note", "steering.origin_um is not verified: it may hide a displaced PSD");
    }
    let publishing = &config.publishing;
    for target in &publishing.udp {
        if let Err(cause) = resolve::resolve(target) {
            let address = &target.address;
            lines.say(
                "note",
                format!("no datagrams to {address} at present: {cause}; the daemon keeps trying"),
            );
        }
    }
    let open = [publishing.tcp, publishing.subscribe].into_iter().flatten().any(|a| !a.ip().is_loopback());
    if open && publishing.allow.iter().all(|network| network.is_loopback()) {
        lines.say(
            "note",
            "publishing.allow contains only this machine: clients on other machines are refused",
        );
    }
    if let Some(address) = config.monitor.listen.filter(|address| !address.ip().is_loopback()) {
        lines.say(
            "note",
            format!("monitor.listen = {address}: every host that reaches it may read, without encryption"),
        );
    }
    let period_ms = 1e3 / config.acquisition.rate_hz;
    let leased = config.centering.mode != LoopMode::Off && config.steering.kind == SteeringKind::Outputs;
    if leased && f64::from(config.steering.lease_ms) < 3.0 * period_ms {
        lines.say(
            "note",
            format!(
                "steering.lease_ms = {} is short: commands are sent with the samples, every {period_ms} ms",
                config.steering.lease_ms
            ),
        );
    }
    if config.centering.mode != LoopMode::Off
        && config.centering.loop_delay_s(config.acquisition.rate_hz) > config.centering.loop_delay_ms * 1e-3
    {
        lines.say("note", "centering.loop_delay_ms is less than two sample periods: two periods are used");
    }
}
