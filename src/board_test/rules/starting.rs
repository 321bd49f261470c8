//! START and STOP.

use std::time::Duration;

use trifacet_wire::board::message::{Reply, StartResult};
use trifacet_wire::board::{Answer, Request};

use crate::board_test::bench::Bench;
use crate::board_test::line::within;
use crate::board_test::verdict::{Broken, fail};

/// A REPLY states the nearest rate of the timer: at most this part from the requested one.
const NEAREST: f64 = 0.1;

fn reply(result: StartResult, rate_mhz: u32) -> Answer {
    Answer::Reply(Reply { start: true, result, rate_mhz })
}

/// Numbers out of range are refused.
pub(super) fn refused(bench: &mut Bench) -> Result<String, Broken> {
    let ([slowest, fastest], limit, good) = (bench.identity.rate_mhz, bench.limit(), bench.rate_mhz());
    let mut cases = vec![("rate 0", 0, [0; 2], StartResult::RateOutOfRange)];
    if let Some(beyond) = fastest.checked_add(1) {
        cases.push(("a rate above the fastest", beyond, [0; 2], StartResult::RateOutOfRange));
    }
    if slowest > 1 {
        cases.push(("a rate below the slowest", slowest - 1, [0; 2], StartResult::RateOutOfRange));
    }
    cases.push(("a parking position above the range", good, [0, limit], StartResult::ParkOutOfRange));
    cases.push(("a parking position below the range", good, [-limit - 1, 0], StartResult::ParkOutOfRange));
    let count = cases.len();
    for (what, rate_mhz, park, result) in cases {
        let mut frame = Vec::new();
        Request::Start { rate_mhz, park, minor: 0 }.encode(&mut frame);
        bench.expect(&format!("START with {what}"), &frame, &reply(result, 0))?;
    }
    Ok(format!("{count} refused"))
}

/// START is replied, and scans come, numbered from 0.
pub(super) fn started(bench: &mut Bench) -> Result<String, Broken> {
    let requested = bench.rate_mhz();
    let Reply { result, rate_mhz, .. } = bench.start(0, [0; 2])?;
    let far = (f64::from(rate_mhz) / f64::from(requested) - 1.0).abs() > NEAREST;
    if result != StartResult::Done || far {
        return fail(format!("{result:?}, {rate_mhz} mHz"), format!("done, about {requested} mHz"));
    }
    let series = bench.series(3)?;
    let first = series.scans[0].scan.sequence;
    if first == 0 {
        Ok(format!("{rate_mhz} mHz"))
    } else {
        fail(format!("the first scan has number {first}"), "0")
    }
}

/// START while started begins again; the clock does not.
pub(super) fn repeated(bench: &mut Bench) -> Result<String, Broken> {
    bench.start(0, [0; 2])?;
    let before = bench.series(20)?;
    bench.start(0, [0; 2])?;
    let after = bench.series(3)?;
    let (last, first) = (before.scans[19].scan, after.scans[0].scan);
    if first.sequence != 0 {
        return fail(format!("the first scan after the second START has number {}", first.sequence), "0");
    }
    // The clock runs on: the few scans in between take much less than half of its range.
    let ticks = (first.tick as u32).wrapping_sub(last.tick as u32);
    if ticks == 0 || ticks > u32::MAX / 2 {
        return fail(
            format!("tick {} before the second START, {} after it", last.tick, first.tick),
            "a clock that runs freely from power-up",
        );
    }
    Ok("numbers from 0, the clock runs on".into())
}

/// STOP is replied, and no scan follows.
pub(super) fn stopped(bench: &mut Bench) -> Result<String, Broken> {
    for (state, start) in [("started", true), ("stopped", false)] {
        if start {
            bench.start(0, [0; 2])?;
            bench.series(3)?;
        }
        let mut frame = Vec::new();
        Request::Stop.encode(&mut frame);
        let done = Answer::Reply(Reply { start: false, result: StartResult::Done, rate_mhz: 0 });
        bench.expect(&format!("STOP while {state}"), &frame, &done)?;
        if let Some(received) = bench.next(within(Duration::from_millis(300)))? {
            return fail(format!("after STOP: {}", received.text()), "nothing");
        }
    }
    Ok("no scan follows".into())
}
