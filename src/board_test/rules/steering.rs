//! STEER and ACK.

use trifacet_wire::actuator::LeaseAction;
use trifacet_wire::board::message::SteerResult;

use crate::board_test::bench::Bench;
use crate::board_test::scans::Series;
use crate::board_test::verdict::{Broken, fail};

/// Number of commands.
const COMMANDS: usize = 100;

/// A command to a stopped board is refused.
pub(super) fn stopped(bench: &mut Bench) -> Result<String, Broken> {
    let within = bench.command([0; 2], 200, LeaseAction::Hold);
    for (what, command) in [("STEER", within), ("STEER with a lease of 0", bench.refused())] {
        bench.expect_ack(&format!("{what} while stopped"), command, SteerResult::NotStarted)?;
    }
    Ok("ACK, not started".into())
}

/// A lease of 0 is refused.
pub(super) fn refused(bench: &mut Bench) -> Result<String, Broken> {
    bench.start(0, [0; 2])?;
    let command = bench.refused();
    bench.expect_ack("STEER with a lease of 0", command, SteerResult::OutOfRange)?;
    Ok("ACK, out of range".into())
}

/// Codes out of range are refused. A board that takes them all the same moves the stage.
pub(super) fn range(bench: &mut Bench) -> Result<String, Broken> {
    bench.start(0, [0; 2])?;
    bench.moves();
    let limit = bench.limit();
    for codes in [[limit, 0], [0, limit], [-limit - 1, 0], [0, i32::MIN]] {
        let command = bench.command(codes, 200, LeaseAction::Hold);
        bench.expect_ack(&format!("STEER to {codes:?}"), command, SteerResult::OutOfRange)?;
    }
    Ok("ACK, out of range".into())
}

/// Every command is acknowledged with its own id, in order.
fn check_acks(series: &Series, ids: &[u32], result: SteerResult) -> Result<(), Broken> {
    let acks: Vec<_> = series.acks.iter().map(|(id, result, _)| (*id, *result)).collect();
    let expected: Vec<_> = ids.iter().map(|id| (*id, result)).collect();
    if acks == expected {
        return Ok(());
    }
    let place =
        acks.iter().zip(&expected).position(|(a, b)| a != b).unwrap_or(acks.len().min(expected.len()));
    let at = |list: &[(u32, SteerResult)]| list.get(place).map_or("nothing".into(), |ack| format!("{ack:?}"));
    fail(format!("{} ACKs for {} STEER; number {place}: {}", acks.len(), ids.len(), at(&acks)), at(&expected))
}

/// One command per scan is acknowledged.
pub(super) fn each_scan(bench: &mut Bench) -> Result<String, Broken> {
    bench.start(0, [0; 2])?;
    let commands: Vec<_> = (0..COMMANDS).map(|_| bench.refused()).collect();
    let ids: Vec<_> = commands.iter().map(|command| command.id).collect();
    let mut waiting = commands.into_iter();
    let series = bench.series_with(2 * COMMANDS, |_| waiting.next())?;
    check_acks(&series, &ids, SteerResult::OutOfRange)?;
    Ok(format!("{COMMANDS} acknowledged in order"))
}

/// Accepted commands are acknowledged.
pub(super) fn accepted(bench: &mut Bench) -> Result<String, Broken> {
    bench.start(0, [0; 2])?;
    bench.moves();
    let amplitude = bench.amplitude().unwrap_or(0);
    let corners = [[amplitude, 0], [0, amplitude], [-amplitude, 0], [0, -amplitude], [0, 0]];
    let commands: Vec<_> = corners.map(|codes| bench.command(codes, 1000, LeaseAction::Hold)).into();
    let ids: Vec<_> = commands.iter().map(|command| command.id).collect();
    let mut waiting = commands.into_iter();
    let series = bench.series_with(COMMANDS, |_| waiting.next())?;
    check_acks(&series, &ids, SteerResult::Accepted)?;
    Ok(format!("{} accepted", ids.len()))
}
