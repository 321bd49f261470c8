//! Scans: numbers, ticks, rate, values.

use std::thread::sleep;
use std::time::Duration;

use trifacet_wire::board::BoardScan;

use crate::board_test::bench::Bench;
use crate::board_test::scans::{Series, Taken};
use crate::board_test::verdict::{Broken, fail};

/// Length of a series, seconds.
const SERIES_S: f64 = 2.0;
/// Series in which scans may be missing before that counts.
const ATTEMPTS: usize = 5;
/// Part of the scans that a healthy line may lose.
const LOST: f64 = 0.01;
/// Largest relative difference of a rate from the stated one, by the clock of the host.
const RATE: f64 = 0.02;
/// Time for which nothing is read.
const PAUSE: Duration = Duration::from_secs(2);

/// Number of scans in a series.
fn length(bench: &Bench) -> usize {
    ((SERIES_S * f64::from(bench.rate_mhz()) * 1e-3) as usize).clamp(20, 20_000)
}

fn series(bench: &mut Bench) -> Result<Series, Broken> {
    bench.start(0, [0; 2])?;
    let series = bench.series(length(bench))?;
    if series.damaged > 0 {
        return fail(
            format!("{} damaged frames", series.damaged),
            "undamaged frames: is the baud rate right?",
        );
    }
    Ok(series)
}

/// Numbers count up from 0.
pub(super) fn sequence(bench: &mut Bench) -> Result<String, Broken> {
    let mut least = u64::MAX;
    // A busy computer reads late, and the board then omits scans rightly.
    for _ in 0..ATTEMPTS {
        let series = series(bench)?;
        let mut lost = 0_u64;
        for pair in series.scans.windows(2) {
            let [before, now] = [pair[0].scan.sequence, pair[1].scan.sequence];
            let step = now.wrapping_sub(before);
            if step == 0 || step > u32::MAX / 2 {
                return fail(format!("number {now} after number {before}"), "numbers that count up");
            }
            lost += u64::from(step - 1);
        }
        if lost as f64 <= LOST * series.scans.len() as f64 {
            return Ok(format!("{} scans, {lost} omitted", series.scans.len()));
        }
        least = least.min(lost);
    }
    fail(
        format!("in each of {ATTEMPTS} series at least {least} numbers are missing"),
        "all scans, as the line has room for them",
    )
}

/// What the tick advances by from scan to scan, and what the numbers require.
fn steps(scans: &[Taken], ticks_per_scan: f64) -> impl Iterator<Item = (u32, f64, &BoardScan)> {
    scans.windows(2).map(move |pair| {
        let [before, now] = [&pair[0].scan, &pair[1].scan];
        let ticks = (now.tick as u32).wrapping_sub(before.tick as u32);
        (ticks, f64::from(now.sequence.wrapping_sub(before.sequence)) * ticks_per_scan, now)
    })
}

/// The tick advances as the numbers require.
pub(super) fn tick(bench: &mut Bench) -> Result<String, Broken> {
    let reply = bench.start(0, [0; 2])?;
    let series = bench.series(length(bench))?;
    check_ticks(&series.scans, f64::from(bench.identity.tick_hz) * 1e3 / f64::from(reply.rate_mhz))?;
    Ok(format!("{} steps agree with the numbers", series.scans.len() - 1))
}

fn check_ticks(scans: &[Taken], ticks_per_scan: f64) -> Result<(), Broken> {
    let (mut since, mut required) = (0.0, 0.0);
    for (ticks, expected, scan) in steps(scans, ticks_per_scan) {
        let tolerance = (0.5 * ticks_per_scan).max(1e-3 * expected) + 2.0;
        let wide = expected >= f64::from(u32::MAX); // it has wrapped, perhaps several times
        if !wide && (f64::from(ticks) - expected).abs() > tolerance {
            return fail(
                format!("scan {}: the tick advanced by {ticks}", scan.sequence),
                format!("{expected:.0} within {tolerance:.0}, as the numbers require"),
            );
        }
        // A small difference that repeats is a wrong rate.
        (since, required) = (since + if wide { expected } else { f64::from(ticks) }, required + expected);
        let tolerance = (0.5 * ticks_per_scan).max(1e-3 * required) + 2.0;
        if (since - required).abs() > tolerance {
            return fail(
                format!("scan {}: the tick has advanced by {since:.0} since the first scan", scan.sequence),
                format!("{required:.0} within {tolerance:.0}, as the numbers require"),
            );
        }
    }
    Ok(())
}

/// Rate of the scans by the clock of the host: from the fastest arrivals at the beginning and at the end.
fn measured_hz(scans: &[Taken], stated_hz: f64) -> f64 {
    let origin = scans[0].at;
    let late_s = |taken: &Taken| {
        let periods = f64::from(taken.scan.sequence.wrapping_sub(scans[0].scan.sequence));
        taken.at.seconds_since(origin) - periods / stated_hz
    };
    let third = scans.len() / 3;
    let fastest = |part: &[Taken]| {
        let best = part.iter().min_by(|a, b| late_s(a).total_cmp(&late_s(b)));
        best.map_or((0.0, 0.0), |taken| (f64::from(taken.scan.sequence) / stated_hz, late_s(taken)))
    };
    let (begin, end) = (fastest(&scans[..third]), fastest(&scans[scans.len() - third..]));
    stated_hz / (1.0 + (end.1 - begin.1) / (end.0 - begin.0))
}

/// The rates of scans and clock are those that the board states.
pub(super) fn rate(bench: &mut Bench) -> Result<String, Broken> {
    let reply = bench.start(0, [0; 2])?;
    let series = bench.series(length(bench))?;
    let stated_hz = f64::from(reply.rate_mhz) * 1e-3;
    let hz = measured_hz(&series.scans, stated_hz);
    if !hz.is_finite() || (hz / stated_hz - 1.0).abs() > RATE {
        return fail(format!("{hz:.4} scans per second"), format!("{stated_hz} as stated in REPLY"));
    }
    let scans = &series.scans;
    let (ticks, numbers) = steps(scans, 1.0)
        .fold((0.0, 0.0), |(ticks, numbers), (step, number, _)| (ticks + f64::from(step), numbers + number));
    let (tick_hz, stated) = (ticks / numbers * hz, f64::from(bench.identity.tick_hz));
    if (tick_hz / stated - 1.0).abs() > RATE && ticks < f64::from(u32::MAX) {
        return fail(
            format!("a clock of {tick_hz:.4e} Hz"),
            format!("{stated:.4e} Hz as stated in IDENTITY"),
        );
    }
    Ok(format!("{hz:.2} scans per second by the clock of this computer"))
}

/// Codes and status are within their ranges.
pub(super) fn values(bench: &mut Bench) -> Result<String, Broken> {
    let (channels, bits) = (bench.identity.roles.len(), bench.identity.converter.bits.clamp(8, 24));
    let full = 1 << (bits - 1);
    for Taken { scan, message, .. } in series(bench)?.scans {
        if usize::from(scan.channels) != channels {
            return fail(format!("{} codes", scan.channels), format!("{channels}, as stated in IDENTITY"));
        }
        if let Some(code) = scan.codes.iter().find(|code| !(-full..full).contains(*code)) {
            return fail(format!("code {code}"), format!("codes of {bits} bits"));
        }
        if message[10] & !7 != 0 {
            return fail(format!("status {:#04x}", message[10]), "only bits 0 to 2");
        }
    }
    Ok(format!("{channels} codes of {bits} bits"))
}

/// A board that finds no room omits whole scans, and goes on sampling.
pub(super) fn full_buffer(bench: &mut Bench) -> Result<String, Broken> {
    let reply = bench.start(0, [0; 2])?;
    bench.series(3)?;
    sleep(PAUSE);
    let series = bench.series(3 * length(bench))?;
    if series.damaged > 1 {
        let why = format!(
            "the operating system lost bytes while nothing was read: {} damaged frames",
            series.damaged
        );
        return Err(Broken::Skip(why));
    }
    check_ticks(&series.scans, f64::from(bench.identity.tick_hz) * 1e3 / f64::from(reply.rate_mhz))?;
    let refused = bench.refused();
    let answered = bench.ask(trifacet_wire::board::Request::Steer(refused))?;
    if answered.is_none() {
        return fail("no answer to the next STEER", "ACK");
    }
    let step = |pair: &[Taken]| pair[1].scan.sequence.wrapping_sub(pair[0].scan.sequence);
    let omitted: u64 = series.scans.windows(2).map(|pair| u64::from(step(pair).saturating_sub(1))).sum();
    Ok(format!("{omitted} scans omitted in {} s without reading", PAUSE.as_secs()))
}
