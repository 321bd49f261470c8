//! A scan of the steering while the mirror is at rest: the shape of the beam, and the steering in units of the PSDs.

use trifacet::acquisition::Source;
use trifacet::calibration::bench::Bench;
use trifacet::calibration::measure::{Goal, NoReading, measure};
use trifacet::calibration::points_writer::PointsFile;
use trifacet::calibration::scan_pattern::{HALF, square};
use trifacet::core::time::Clock;
use trifacet::exit::{self, Failure};
use trifacet_core::centering::{LoopMode, LoopParams};
use trifacet_core::steering::{BeamOffset, StagePosition};
use trifacet_optics::Optics;

/// The smallest half side that is worth a scan, metres.
const SMALLEST: f64 = 50e-6;
/// Time for the stage to reach a commanded position, seconds.
const ARRIVAL_S: f64 = 5.0;
/// Lags after which the stage has reached a position to 5e-5 of the way.
const SETTLED_LAGS: f64 = 10.0;

/// What became of a scan.
pub(super) enum Scanned {
    /// This number of positions has a reading.
    Done(usize),
    /// There was no scan.
    Omitted(String),
}

/// Moves the beam over a square around the apex, and writes a reading at each position. The loop is on again at the
/// end.
pub(super) async fn scan<S: Source, C: Clock>(
    bench: &mut Bench<S, C>,
    goal: Goal,
    optics: &Optics,
    file: &mut PointsFile,
    utc: impl Fn(&trifacet::calibration::reading::Reading) -> f64,
) -> anyhow::Result<Scanned> {
    let Some(centre) = bench.commanded() else {
        return Ok(Scanned::Omitted("the loop does not control the steering".into()));
    };
    let half = half_side(bench.params(), centre);
    if half < SMALLEST {
        let limit = bench.params().controller.limit * 1e6;
        return Ok(Scanned::Omitted(format!(
            "the steering is at {:.0} {:.0} um, too near its limit of {limit:.0} um (steering.limit_um) for a scan of \
             +-{:.0} um",
            centre[0] * 1e6,
            centre[1] * 1e6,
            SMALLEST * 1e6
        )));
    }
    if half < HALF {
        eprintln!("the range of the steering allows a scan of +-{:.0} um only", half * 1e6);
    }
    bench.switch(LoopMode::Manual);
    let mut taken = 0;
    for (number, offset) in (1..).zip(square(half)) {
        go(bench, centre, offset).await?;
        match measure(bench, goal, optics).await {
            Ok(reading) if reading.stage.is_none() => {
                bench.switch(LoopMode::On);
                return Ok(Scanned::Omitted("the steering has no readback, and reports no position".into()));
            }
            Ok(reading) => {
                file.append(number, utc(&reading), &reading, None)?;
                taken += 1;
            }
            Err(NoReading::Restless(why)) => eprintln!("position {number} of the scan is left out: {why}"),
            Err(NoReading::Failed(failure)) => return Err(failure.into()),
        }
    }
    bench.move_to(centre)?;
    bench.switch(LoopMode::On);
    Ok(Scanned::Done(taken))
}

/// Half the side of the largest square around this position within the limits of the stage; at most [`HALF`].
fn half_side(params: &LoopParams, centre: StagePosition) -> f64 {
    let [x, y] = [[1.0, 0.0], [0.0, 1.0]].map(|unit| params.map.stage_step(BeamOffset(unit)));
    let of_axis = |i: usize| (params.controller.limit - centre[i].abs()) / (x[i].abs() + y[i].abs());
    of_axis(0).min(of_axis(1)).min(HALF)
}

/// Sends the stage to a position, and waits until it is there.
async fn go<S: Source, C: Clock>(
    bench: &mut Bench<S, C>,
    centre: StagePosition,
    offset: BeamOffset,
) -> Result<(), Failure> {
    let LoopParams { map, loop_delay_s, lag_s, .. } = *bench.params();
    let step = map.stage_step(offset);
    let to = StagePosition([centre[0] + step[0], centre[1] + step[1]]);
    bench.move_to(to)?;
    let (mut since, mut there) = (None, None);
    loop {
        let now = bench.next().await?.time;
        let far = bench.commanded().is_none_or(|at| (at[0] - to[0]).hypot(at[1] - to[1]) > 1e-9);
        if !far && now.seconds_since(*there.get_or_insert(now)) > loop_delay_s + SETTLED_LAGS * lag_s {
            return Ok(());
        }
        if far {
            bench.move_to(to)?; // after a gap in the samples, the loop forgets where it was sent
        }
        if now.seconds_since(*since.get_or_insert(now)) > ARRIVAL_S {
            let why = bench.stage_trouble().unwrap_or("its velocity limit or a fault holds it");
            let what = format!("the steering did not reach a position of the scan: {why}");
            return Err(Failure::new(exit::UNAVAILABLE, what));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_stays_within_the_limits_of_the_stage() {
        let params = LoopParams::default();
        assert_eq!(half_side(&params, StagePosition([0.0; 2])), HALF);
        assert!((half_side(&params, StagePosition([0.0, -330e-6])) - 70e-6).abs() < 1e-12);
    }
}
