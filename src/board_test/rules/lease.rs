//! Leases: expiry, renewal, parking. All commands stay within the amplitude.

use trifacet_wire::actuator::{LeaseAction, OutputCommand};
use trifacet_wire::channel::Role;

use crate::board_test::bench::Bench;
use crate::board_test::scans::{Series, Taken};
use crate::board_test::verdict::{Broken, fail};

/// Lease of the commands, milliseconds.
const LEASE_MS: u16 = 800;
/// A lease ends within this part of its length, and five periods.
const TOLERANCE: f64 = 0.25;
/// The stage must move by this multiple of the noise of its readback.
const CLEAR: f64 = 10.0;

/// Number of scans in this many leases.
fn scans_in(bench: &Bench, leases: f64) -> usize {
    (leases * f64::from(LEASE_MS) * 1e-3 * f64::from(bench.rate_mhz()) * 1e-3).ceil() as usize + 5
}

fn corner(bench: &Bench) -> [i32; 2] {
    [bench.amplitude().unwrap_or(0), 0]
}

fn command(bench: &mut Bench, codes: [i32; 2], on_expiry: LeaseAction) -> OutputCommand {
    bench.moves();
    bench.command(codes, LEASE_MS, on_expiry)
}

/// The scan before which this command arrived, by its ACK.
fn arrival(series: &Series, command: &OutputCommand) -> Result<usize, Broken> {
    let ack = series.acks.iter().find(|(id, ..)| *id == command.id);
    ack.map(|(.., scans)| *scans)
        .ok_or_else(|| Broken::Skip("no ACK tells when the command arrived: see steer-accepted".into()))
}

/// Checks that bit 1 is set first in a scan that is one lease after the scan `begin`.
fn check_end(bench: &Bench, series: &Series, begin: usize) -> Result<f64, Broken> {
    if begin + 1 >= series.scans.len() {
        return Err(Broken::Busy);
    }
    let ms_per_scan = 1e6 / f64::from(bench.rate_mhz());
    let number = |k: usize| f64::from(series.scans[k].scan.sequence);
    let expired = (begin + 1..series.scans.len()).find(|k| series.scans[*k].scan.lease_expired);
    let lease_ms = f64::from(LEASE_MS);
    let Some(expired) = expired else {
        let seen_ms = (number(series.scans.len() - 1) - number(begin)) * ms_per_scan;
        return fail(
            format!("bit 1 of the status is not set within {seen_ms:.0} ms"),
            format!("it is set {lease_ms} ms after the last command"),
        );
    };
    let after_ms = (number(expired) - number(begin)) * ms_per_scan;
    if (after_ms - lease_ms).abs() > TOLERANCE * lease_ms + 5.0 * ms_per_scan {
        return fail(
            format!("bit 1 of the status is set {after_ms:.0} ms after the last accepted command"),
            format!("{lease_ms} ms"),
        );
    }
    Ok(after_ms)
}

/// A lease without a newer command expires, and the next command ends that state.
pub(super) fn expires(bench: &mut Bench) -> Result<String, Broken> {
    bench.start(0, [0; 2])?;
    let (first, second) =
        (command(bench, corner(bench), LeaseAction::Hold), command(bench, [0; 2], LeaseAction::Hold));
    let later = scans_in(bench, 2.0);
    let series = bench.series_with(scans_in(bench, 2.5), |scans| match scans {
        5 => Some(first),
        _ if scans == later => Some(second),
        _ => None,
    })?;
    let after_ms = check_end(bench, &series, arrival(&series, &first)?)?;
    let renewed = arrival(&series, &second)?;
    match series.scans.iter().skip(renewed + 1).find(|taken| taken.scan.lease_expired) {
        Some(taken) => fail(
            format!("bit 1 of the status is still set in scan {} after a new command", taken.scan.sequence),
            "it is clear from the next accepted command on",
        ),
        None => Ok(format!("after {after_ms:.0} ms of {LEASE_MS} ms")),
    }
}

/// Each command replaces the lease of the one before.
pub(super) fn renewed(bench: &mut Bench) -> Result<String, Broken> {
    bench.start(0, [0; 2])?;
    let commands: [_; 4] = std::array::from_fn(|_| command(bench, [0; 2], LeaseAction::Hold));
    let every = scans_in(bench, 0.5);
    let series = bench.series_with(scans_in(bench, 4.0), |scans| {
        (scans % every == 0).then(|| commands.get(scans / every - 1).copied()).flatten()
    })?;
    let (begin, end) = (arrival(&series, &commands[0])?, arrival(&series, &commands[3])?);
    let mut arrivals = Vec::new();
    for command in &commands {
        arrivals.push(arrival(&series, command)?);
    }
    if arrivals.windows(2).any(|pair| pair[1].saturating_sub(pair[0]) > scans_in(bench, 0.8)) {
        return Err(Broken::Busy);
    }
    let between = series.scans.get(begin + 1..end).unwrap_or_default();
    if between.iter().any(|taken| taken.scan.lease_expired) {
        return fail("the lease expires although newer commands arrive in time", "each command renews it");
    }
    check_end(bench, &series, end)?;
    Ok("by each command".into())
}

/// A refused command does not renew the lease.
pub(super) fn refused(bench: &mut Bench) -> Result<String, Broken> {
    bench.start(0, [0; 2])?;
    let (accepted, refused) = (command(bench, [0; 2], LeaseAction::Hold), bench.refused());
    let later = scans_in(bench, 0.7);
    let series = bench.series_with(scans_in(bench, 2.5), |scans| match scans {
        5 => Some(accepted),
        _ if scans == later => Some(refused),
        _ => None,
    })?;
    check_end(bench, &series, arrival(&series, &accepted)?)?;
    Ok("it continues after a refused command".into())
}

/// A running lease continues over STOP and START.
pub(super) fn continues(bench: &mut Bench) -> Result<String, Broken> {
    bench.start(0, [0; 2])?;
    let accepted = command(bench, [0; 2], LeaseAction::Hold);
    bench.series_with(20, |scans| (scans == 5).then_some(accepted))?;
    bench.settle()?;
    bench.start(0, [0; 2])?;
    let series = bench.series(scans_in(bench, 2.0))?;
    if series.scans.iter().any(|taken| taken.scan.lease_expired) {
        Ok("it expires after STOP and START".into())
    } else {
        fail("after STOP and START the lease does not expire any more", "a running lease continues")
    }
}

/// Mean and standard deviation of a channel.
fn statistics(scans: &[Taken], channel: usize) -> (f64, f64) {
    let codes: Vec<_> = scans.iter().map(|taken| f64::from(taken.scan.codes[channel])).collect();
    let mean = codes.iter().sum::<f64>() / codes.len() as f64;
    let square = codes.iter().map(|code| (code - mean).powi(2)).sum::<f64>() / codes.len() as f64;
    (mean, square.sqrt())
}

/// With `on_expiry` 0 the outputs hold, with 1 they go to the parking position: by the readback.
pub(super) fn parks(bench: &mut Bench) -> Result<String, Broken> {
    let Some(channel) = bench.identity.roles.iter().position(|role| *role == Role::Steering(0)) else {
        return Err(Broken::Skip("the board reads the position of the stage not back".into()));
    };
    let (there, park) = (corner(bench), corner(bench).map(|code| -code));
    bench.start(0, park)?;
    let mut mean_after = |on_expiry| -> Result<[(f64, f64); 2], Broken> {
        let go = command(bench, there, on_expiry);
        let series = bench.series_with(scans_in(bench, 1.0), |scans| (scans == 1).then_some(go))?;
        let begin = arrival(&series, &go)?;
        let after = bench.series(scans_in(bench, 2.0))?;
        // In the second half of the lease the stage has arrived; so it has at the end.
        let half = scans_in(bench, 0.5);
        let Some(before) = series.scans.get(begin + half..begin + half + half / 2) else {
            return Err(Broken::Busy);
        };
        Ok([statistics(before, channel), statistics(&after.scans[after.scans.len() - half..], channel)])
    };
    let [at, held] = mean_after(LeaseAction::Hold)?;
    let [again, parked] = mean_after(LeaseAction::Park)?;
    let noise = [at, held, again, parked].iter().map(|(_, sigma)| *sigma).fold(1.0, f64::max);
    let moved = |from: (f64, f64), to: (f64, f64)| (to.0 - from.0).abs() > CLEAR * noise;
    if moved(at, held) {
        return fail(
            format!("with on_expiry 0 the readback goes from {:.0} to {:.0}", at.0, held.0),
            "the outputs hold",
        );
    }
    if !moved(again, parked) {
        return fail(
            format!("with on_expiry 1 the readback stays at {:.0} (noise {noise:.0})", again.0),
            "the outputs go to the parking position",
        );
    }
    Ok(format!("holds at {:.0}, parks at {:.0}", held.0, parked.0))
}
