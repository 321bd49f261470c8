//! Checks across sections: each value is within its own range, but they may conflict.

use std::net::SocketAddr;
use std::path::Path;

use trifacet_core::centering::OnExit;
use trifacet_core::centering::stability::is_stable;
use trifacet_optics::{Pose, Vec2};
use trifacet_wire::board::{ScanFormat, required_baud};
use trifacet_wire::channel::SIGNALS;

use super::check::Checker;
use super::tilt::allowed_geometry;
use super::{
    BoardPlace, CenteringConfig, Config, Destination, Host, LabjackOutputs, Model, RecordingMode, SourceKind,
    SteeringKind,
};

/// Gain margin: gains are refused if the loop would be unstable with gains that are larger by this factor.
const MARGIN: f64 = 1.2;

/// Runs all cross-checks. Called once every value is within its own range.
pub(super) fn check(config: &Config, at: &mut Checker<'_>) {
    light_at_rest(config, at);
    match config.acquisition.source {
        SourceKind::Twin => twin_signals(config, at),
        SourceKind::Board | SourceKind::Serial => board_speed(config, at),
        SourceKind::Labjack => labjack(config, at),
        SourceKind::Replay => replay(config, at),
    }
    ports(config, at);
    edge_margin(config, at);
    fusion(config, at);
    gains(config, at);
}

/// The head can be built, and with the mirror in its nominal pose the light reaches all three PSDs.
fn light_at_rest(config: &Config, at: &mut Checker<'_>) {
    let optics = match config.optics() {
        Ok(optics) => optics,
        Err(error) => {
            let (key, allowed) = allowed_geometry(&error);
            at.demand(false, key, error, allowed);
            return;
        }
    };
    let model = config.estimation.model.into();
    if let Err(error) = optics.trace(model, &Pose::default(), Vec2::zeros()) {
        let allowed = "a geometry in which the light reaches all three PSDs while the mirror is at rest";
        let key = if config.pivot_mm().is_some() { "steering.tilt.pivot_mm" } else { "head" };
        at.demand(false, key, error, allowed);
    }
}

/// The twin's signals are within the range of its converter, and its channels fit into a sample period.
fn twin_signals(config: &Config, at: &mut Checker<'_>) {
    let twin = &config.twin;
    let most = twin.converter_range_v * config.channels.clip_limit;
    let brightest = config
        .twin_gains()
        .iter()
        .zip([2, 5, 8])
        .map(|(gain, sum)| twin.laser_mw / 3.0 / config.channels.power_mw_per_v * gain[2] + twin.dark_v[sum])
        .fold(0.0, f64::max);
    at.agree(
        brightest < most,
        "twin.laser_mw",
        &["channels.power_mw_per_v", "channels.clip_limit", "twin.converter_range_v", "twin.dark_v"],
        twin.laser_mw,
        format_args!(
            "a power whose third reads below {most} V on the sum channel; it reads {brightest:.3} V"
        ),
    );
    if let Some(head) = &twin.head {
        at.agree(
            head.psd_size_mm == config.head.psd_size_mm,
            "twin.head.psd_size_mm",
            &["head.psd_size_mm"],
            head.psd_size_mm,
            format_args!(
                "head.psd_size_mm, {}: the unit of positions, which no calibration changes",
                config.head.psd_size_mm
            ),
        );
    }
    at.agree(
        twin.steering.readback_noise_um.is_none() || config.steering.kind != SteeringKind::Gcs,
        "twin.steering.readback_noise_um",
        &["steering.kind"],
        format!("{:?}", twin.steering.readback_noise_um.unwrap_or_default()),
        "\"off\" with another stage: the twin does not measure the position of an external stage",
    );
    if twin.steering.readback_noise_um.is_some() {
        let reach = config.steering.limit_um.min(twin.steering.limit_um) / config.channels.readback_um_per_v;
        at.agree(
            reach < most,
            "channels.readback_um_per_v",
            &["steering.limit_um", "twin.steering.limit_um", "channels.clip_limit", "twin.converter_range_v"],
            format!("{:?}", config.channels.readback_um_per_v),
            format_args!(
                "a value with which the readback at the steering limit is below {most} V; it is {reach:.3} V"
            ),
        );
    }
    let skew_us = twin.channel_skew_us * (twin.channel_count() - 1) as f64;
    let period_us = 1e6 / config.acquisition.rate_hz;
    at.agree(
        skew_us < period_us,
        "twin.channel_skew_us",
        &["acquisition.rate_hz"],
        twin.channel_skew_us,
        format_args!("a skew that fits {} channels into a period of {period_us} us", twin.channel_count()),
    );
}

/// The serial line has the bandwidth for the data of the board. The number of channels is known only to the board,
/// and the daemon queries it later. Nine is the minimum.
fn board_speed(config: &Config, at: &mut Checker<'_>) {
    let acquisition = &config.acquisition;
    let Some(baud) = acquisition.board().and_then(|place| place.baud()) else { return };
    let [_, key] = acquisition.board_keys();
    let needed = required_baud(SIGNALS.len(), acquisition.rate_hz, ScanFormat::Short);
    at.agree(
        baud >= needed,
        &format!("acquisition.{key}"),
        &["acquisition.rate_hz"],
        baud,
        format_args!("{needed} or more, for nine channels at {} Hz", acquisition.rate_hz),
    );
}

/// Highest number of samples per second of a T7, in the range of +-10 V and with resolution index 0 or 1.
const LABJACK_SAMPLES_HZ: f64 = 100_000.0;

/// The scans fit into the rate of the device and into their period, and its watchdog can park the outputs.
fn labjack(config: &Config, at: &mut Checker<'_>) {
    let labjack = &config.acquisition.labjack;
    let (entries, rate_hz) = (labjack.entries() as f64, config.acquisition.rate_hz);
    at.agree(
        entries * rate_hz <= LABJACK_SAMPLES_HZ,
        "acquisition.rate_hz",
        &["acquisition.labjack.inputs", "acquisition.labjack.readback"],
        rate_hz,
        format_args!(
            "at most {:.1}: a T7 takes 100 000 samples per second, and a scan has {entries} (the timer is two)",
            LABJACK_SAMPLES_HZ / entries
        ),
    );
    let scan_us = entries * labjack.interval_us.max(labjack.settling_us);
    at.agree(
        scan_us <= 1e6 / rate_hz,
        "acquisition.labjack.interval_us",
        &["acquisition.labjack.settling_us", "acquisition.rate_hz"],
        labjack.interval_us,
        format_args!("an interval with which {entries} entries fit into a period; they take {scan_us} us"),
    );
    let outputs = config.steering.kind == SteeringKind::Outputs;
    at.agree(
        !outputs || labjack.outputs == LabjackOutputs::Dac || config.steering.on_lease == OnExit::Hold,
        "steering.on_lease",
        &["acquisition.labjack.outputs"],
        "\"park\"",
        "\"hold\" with outputs = \"ljtick-dac\": the watchdog of a T7 cannot move an LJTick-DAC",
    );
}

/// Board and stage are at different places, also if a device has several names; the board is not where this daemon
/// listens; and the servers listen at different addresses.
fn ports(config: &Config, at: &mut Checker<'_>) {
    if let Some(board) = config.acquisition.board() {
        board_apart(&board, config, at);
    }
    if let (Some(tcp), Some(monitor)) = (config.publishing.tcp, config.monitor.listen) {
        at.agree(
            !collide(tcp, monitor),
            "monitor.listen",
            &["publishing.tcp"],
            format!("\"{monitor}\""),
            format_args!("another port than publishing.tcp = \"{tcp}\": only one server can listen at it"),
        );
    }
}

/// Nothing else of the configuration is at the place of the board.
fn board_apart(board: &BoardPlace, config: &Config, at: &mut Checker<'_>) {
    let [key, _] = config.acquisition.board_keys();
    let own = format!("acquisition.{key}");
    let stage = (config.steering.kind == SteeringKind::Gcs).then_some(&config.steering.gcs);
    let clash = match board {
        BoardPlace::Serial { port, .. } => stage
            .and_then(|stage| stage.port.as_ref())
            .filter(|stage| is_same_device(stage, port))
            .map(|stage| ("steering.gcs.port", stage.display().to_string(), "another device than")),
        BoardPlace::Tcp(address) => stage
            .and_then(|stage| stage.address.as_ref())
            .filter(|stage| **stage == address.to_string())
            .map(|stage| ("steering.gcs.address", stage.clone(), "another address than")),
        BoardPlace::Unix(_) => None,
    };
    if let Some((stage, found, another)) = clash {
        let place = match board {
            BoardPlace::Serial { .. } => "a port",
            BoardPlace::Tcp(_) | BoardPlace::Unix(_) => "an address",
        };
        at.agree(
            false,
            stage,
            &[&own],
            format!("{found:?}"),
            format_args!(
                "{another} {own} = {:?}: the board and the controller of the stage cannot share {place}",
                board.to_string()
            ),
        );
    }
    let mine = own_listener(board, config);
    at.agree(
        mine.is_none(),
        &own,
        &[mine.unwrap_or_default()],
        format!("{:?}", board.to_string()),
        format_args!(
            "the place of a board: at this one the daemon listens itself ({})",
            mine.unwrap_or_default()
        ),
    );
}

/// The key of a server of this daemon that listens at this place.
fn own_listener(board: &BoardPlace, config: &Config) -> Option<&'static str> {
    match board {
        BoardPlace::Serial { .. } => None,
        BoardPlace::Tcp(Destination { host, port }) => {
            let servers =
                [("publishing.tcp", config.publishing.tcp), ("monitor.listen", config.monitor.listen)];
            let here = |listens: SocketAddr| match host {
                Host::Address(ip) => {
                    let same = *ip == listens.ip() || (ip.is_loopback() && listens.ip().is_unspecified());
                    same && listens.port() == *port
                }
                Host::Name(name) => name == "localhost" && listens.port() == *port,
                Host::Zoned(..) => false,
            };
            servers.into_iter().find(|(_, listens)| listens.is_some_and(here)).map(|(key, _)| key)
        }
        BoardPlace::Unix(path) => (config.control.socket.as_ref() == Some(path)).then_some("control.socket"),
    }
}

/// Whether two paths lead to the same device. A device that is not connected has only its name.
fn is_same_device(a: &Path, b: &Path) -> bool {
    let target = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    target(a) == target(b)
}

/// Whether two servers would listen at the same address. Port 0 stands for any free port.
fn collide(a: SocketAddr, b: SocketAddr) -> bool {
    let any = a.ip().is_unspecified() || b.ip().is_unspecified();
    a.port() == b.port() && a.port() != 0 && (any || a.ip() == b.ip())
}

/// A replay has a recording, steers no real stage, and records nothing.
fn replay(config: &Config, at: &mut Checker<'_>) {
    let source = "acquisition.source";
    let file = &config.replay.file;
    at.agree(
        !file.as_os_str().is_empty(),
        "replay.file",
        &[source],
        "\"\"",
        "a recording, with acquisition.source = \"replay\"",
    );
    // Do not open the file here: opening a pipe would block until it has a writer.
    let wrong = match file.metadata() {
        Ok(about) if about.is_file() => None,
        Ok(_) => Some("not a regular file".to_owned()),
        Err(error) => Some(error.to_string()),
    };
    if let Some(why) = wrong.filter(|_| !file.as_os_str().is_empty()) {
        let allowed = format!("a recording, relative to this file: {}: {why}", file.display());
        at.demand(false, "replay.file", format!("\"{}\"", file.display()), allowed);
    }
    at.agree(
        config.steering.kind != SteeringKind::Gcs,
        "steering.kind",
        &[source],
        "\"gcs\"",
        "\"outputs\" with acquisition.source = \"replay\": a replay sends no commands to a stage",
    );
    at.agree(
        config.recording.mode == RecordingMode::Off,
        "recording.mode",
        &[source],
        format!("{:?}", config.recording.mode.name()),
        "\"off\" with acquisition.source = \"replay\": the samples are already recorded",
    );
}

/// The loop is stable, with a margin.
fn gains(config: &Config, at: &mut Checker<'_>) {
    let (centering, rate_hz) = (&config.centering, config.acquisition.rate_hz);
    let (gains, delay_s) = (centering.gains(rate_hz), centering.loop_delay_s(rate_hz));
    let safe = CenteringConfig { kp: None, ki_per_s: None, ..centering.clone() }.gains(rate_hz);
    at.agree(
        is_stable([MARGIN * gains.kp, MARGIN * gains.ki_per_s], delay_s, centering.lag_ms * 1e-3, 1.0 / rate_hz),
        "centering.ki_per_s",
        &["centering.kp", "centering.loop_delay_ms"],
        format!("{} with kp = {}", gains.ki_per_s, gains.kp),
        format_args!(
            "lower gains: the loop is not stable with a loop delay of {} ms; stable: ki_per_s = {} with kp = {}",
            delay_s * 1e3,
            safe.ki_per_s,
            safe.kp
        ),
    );
}

fn edge_margin(config: &Config, at: &mut Checker<'_>) {
    let half = config.head.psd_size_mm / 2.0;
    at.agree(
        config.estimation.edge_margin_mm < half,
        "estimation.edge_margin_mm",
        &["head.psd_size_mm"],
        config.estimation.edge_margin_mm,
        format_args!("less than half of head.psd_size_mm, {half}"),
    );
}

/// `fuse_steering` needs a model that includes the beam's offset, and a readback. Whether a board has a
/// readback is known only once it is connected; the daemon then warns.
fn fusion(config: &Config, at: &mut Checker<'_>) {
    let fuse = config.estimation.fuse_steering;
    at.agree(
        !fuse || config.estimation.model == Model::Gaussian,
        "estimation.fuse_steering",
        &["estimation.model"],
        fuse,
        "false with estimation.model = \"ray\", which has no beam offset; or the model \"gaussian\"",
    );
    let readback = config.twin.steering.readback_noise_um.is_some();
    at.agree(
        !fuse || readback || config.acquisition.source != SourceKind::Twin,
        "estimation.fuse_steering",
        &["twin.steering.readback_noise_um"],
        fuse,
        "false with twin.steering.readback_noise_um = \"off\", without a position to fuse",
    );
}
