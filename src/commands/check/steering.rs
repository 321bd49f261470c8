//! Explains the settings of the loop and its stage.

use std::path::Path;

use trifacet::config::{Config, GcsConfig, LabjackOutputs, SourceKind, SteeringKind};
use trifacet_core::centering::search::Spiral;
use trifacet_core::centering::{LoopMode, OnExit, Target};
use trifacet_core::estimation::integrity::{LIMIT, SlowResidual};
use trifacet_core::steering::StagePosition;
use trifacet_optics::{Innovation, Vec2};

use super::Lines;

pub(super) fn centering(config: &Config, lines: &mut Lines) {
    let centering = &config.centering;
    if config.acquisition.source == SourceKind::Replay {
        return lines
            .say("steering", "off: a recording is replayed, including the recorded moves of its loop");
    }
    match centering.mode {
        LoopMode::Off => return lines.say("centering", "off: the laser does not move"),
        LoopMode::Manual => {
            return lines.say("centering", "manual: `trifacet ctl move` moves the laser");
        }
        LoopMode::On | LoopMode::Shadow => {}
    }
    let rate_hz = config.acquisition.rate_hz;
    let target = match centering.target {
        Target::Apex => "the beam on the apex",
        Target::Balance => "equal powers on the PSDs",
    };
    let gains = centering.gains(rate_hz);
    let delay_ms = 1e3 * centering.loop_delay_s(rate_hz);
    let (kp, ki) = (gains.kp, gains.ki_per_s);
    lines.say("centering", format!("{target}; Kp {kp:.4}, Ki {ki:.4} /s for a loop delay of {delay_ms} ms"));
    if centering.feed_forward {
        lines.say(
            "",
            format!("feed-forward by a tracking filter of {:.1} Hz", centering.tracking_hz(rate_hz)),
        );
    }
    let (limit_um, lock_ms, lost_ms) =
        (centering.lock_limit_um, centering.lock_time_ms, centering.lost_time_ms);
    lines.say(
        "",
        format!("locked within {limit_um} um for {lock_ms} ms, lost after {lost_ms} ms without light"),
    );
    lines.say("", search(config));
    if centering.mode == LoopMode::Shadow {
        lines.say("", "shadow: the loop computes its moves, but the laser does not move");
    }
}

fn search(config: &Config) -> String {
    let centering = &config.centering;
    if !centering.search {
        return "no search after the light is lost".into();
    }
    let spiral =
        Spiral::of(&config.loop_params(), StagePosition([0.0; 2]), config.head.beam_diameter_mm * 0.5e-3);
    format!(
        "at most {} searches after the light is lost; one takes {:.2} s from the middle to the limits",
        centering.search_attempts,
        spiral.duration(1.0 / config.acquisition.rate_hz)
    )
}

pub(super) fn stage(config: &Config, lines: &mut Lines) {
    let steering = &config.steering;
    let does = |action: OnExit| match action {
        OnExit::Hold => "holds".to_owned(),
        OnExit::Park => format!("parks at {:?} um", steering.park_um),
    };
    let limits = format!("within +-{} um, at most {} mm/s", steering.limit_um, steering.slew_mm_per_s);
    let at_the_end = format!("{} when the daemon ends", does(steering.on_exit));
    match steering.kind {
        SteeringKind::Outputs => {
            let full_scale_um = steering.full_scale_um;
            let source = match config.acquisition.source {
                SourceKind::Twin => "the twin's own stage",
                SourceKind::Board | SourceKind::Serial => "the two outputs of the board",
                SourceKind::Labjack => match config.acquisition.labjack.outputs {
                    LabjackOutputs::Dac => "DAC0 and DAC1 of the LabJack T7",
                    LabjackOutputs::LjtickDac => "an LJTick-DAC at the LabJack T7",
                },
                SourceKind::Replay => return,
            };
            lines.say("steering", format!("{source}, full scale +-{full_scale_um} um, {limits}"));
            let on_lease = does(steering.on_lease);
            lines.say(
                "",
                format!("{at_the_end}; {on_lease} if no command arrives for {} ms", steering.lease_ms),
            );
        }
        SteeringKind::Tilt => {
            let pivot = config.pivot_mm().unwrap_or_default();
            lines.say("steering", format!("a mirror that tilts the beam about the point {pivot:?} mm"));
            lines.say(
                "",
                "only check, trace and solve compute with such a beam; run refuses this configuration",
            );
        }
        SteeringKind::Gcs => {
            lines.say("steering", format!("{}, {limits}", gcs(&steering.gcs)));
            lines.say("", format!("{at_the_end}; holds if no command arrives: it has no lease"));
        }
    }
}

/// The limits of the steering residual, for a mirror at rest.
pub(super) fn residual(config: &Config, innovation: &Innovation<'_>, lines: &mut Lines) {
    let window = SlowResidual::window(config.acquisition.rate_hz / f64::from(config.estimation.average));
    let limit =
        |reports| innovation.mean_sigma(Vec2::x(), reports).map_or(f64::NAN, |sigma| sigma * LIMIT * 1e6);
    let [single, mean] = [1.0, 2.0 * window - 1.0].map(limit);
    let [readback, pointing] = config.steering.beam_sigma_parts_um();
    lines.say(
        "readback",
        format!("standard uncertainty {readback:.3} um, pointing of the laser {pointing:.3} um per axis"),
    );
    lines.say(
        "",
        format!("INCONSISTENT beyond a residual of {single:.2} um in ten reports, or a mean residual of {mean:.2} um"),
    );
}

fn gcs(gcs: &GcsConfig) -> String {
    let line = match (&gcs.address, &gcs.port) {
        (Some(address), _) => address.clone(),
        (None, port) => format!("{}, {} baud", port.as_deref().unwrap_or(Path::new("")).display(), gcs.baud),
    };
    let [x, y] = &gcs.axes;
    let (unit, zero) = (gcs.um_per_unit, gcs.zero_um);
    format!("PI stage (GCS 2.0) at {line}, axes {x} and {y} in units of {unit} um, zero at {zero:?} um")
}
