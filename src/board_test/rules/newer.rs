//! Versions, and what version 1.1 adds to the scans.

use trifacet_wire::actuator::LeaseAction;
use trifacet_wire::board::message::ErrorReason;
use trifacet_wire::board::{Answer, MINOR, Request, ScanFormat};

use crate::board_test::bench::Bench;
use crate::board_test::verdict::{Broken, fail};

/// Scans after an ACK that may have been taken before its command: a board may send them late.
const LATE: usize = 16;

fn older<T>() -> Result<T, Broken> {
    Err(Broken::Skip("the board speaks version 1.0".into()))
}

/// Bit 1 of the flags agrees with the answers to requests of version 1.1.
pub(super) fn versions(bench: &mut Bench) -> Result<String, Broken> {
    let newer = bench.identity.extensible;
    let rate_mhz = bench.rate_mhz();
    let frame = |request: Request| {
        let mut frame = Vec::new();
        request.encode(&mut frame);
        frame
    };
    let identify = frame(Request::Identify { minor: MINOR });
    let start = |minor| frame(Request::Start { rate_mhz, park: [0; 2], minor });
    if !newer {
        let length = |kind| Answer::Error { reason: ErrorReason::Length, kind };
        bench.expect("IDENTIFY of version 1.1 to a board of version 1.0", &identify, &length(1))?;
        bench.expect("START of version 1.1 to a board of version 1.0", &start(1), &length(2))?;
        return Ok("1.0".into());
    }
    let extension = match bench.answer_to(&identify)?.and_then(|received| received.answer()) {
        Some(Answer::Identity(identity)) => identity.extension,
        other => return fail(format!("IDENTIFY of version 1.1: {other:?}"), "IDENTITY of version 1.1"),
    };
    let Some(extension) = extension else {
        return fail(
            "IDENTITY of version 1.0 to IDENTIFY of version 1.1",
            "IDENTITY of version 1.1, as bit 1 states",
        );
    };
    if extension.minor == MINOR {
        let value = Answer::Error { reason: ErrorReason::Value, kind: 2 };
        bench.expect("START of version 1.2", &start(MINOR + 1), &value)?;
    }
    Ok(format!("1.{}", extension.minor))
}

/// START with a minor version is followed by LONG_SCAN, without one by SCAN.
pub(super) fn long_scan(bench: &mut Bench) -> Result<String, Broken> {
    let Some(extension) = bench.identity.extension.clone() else { return older() };
    for (minor, format) in
        [(1, extension.scan_format()), (0, ScanFormat::Short), (1, extension.scan_format())]
    {
        bench.start(minor, [0; 2])?;
        let series = bench.series(20)?;
        if let Some(other) = series.scans.iter().find(|taken| taken.scan.format != format) {
            let seen = format!("START with minor version {minor}: scans of {:?}", other.scan.format);
            return fail(seen, format!("{format:?}"));
        }
        let reserved = |message: &[u8]| if minor > 0 { message[6] & !31 } else { 0 };
        if let Some(taken) = series.scans.iter().find(|taken| reserved(&taken.message) != 0) {
            return fail(format!("status {:#04x}", taken.message[6]), "only bits 0 to 4");
        }
    }
    Ok(format!("ticks of {} bits", extension.scan_format().tick_bits()))
}

/// The scans state the last accepted command.
pub(super) fn applied(bench: &mut Bench) -> Result<String, Broken> {
    let Some(extension) = bench.identity.extension.clone() else { return older() };
    bench.start(extension.minor.min(MINOR), [0; 2])?;
    bench.moves();
    let amplitude = bench.amplitude().unwrap_or(0);
    let accepted = bench.command([amplitude, 0], 2000, LeaseAction::Hold);
    let refused = bench.refused();
    let home = bench.command([0; 2], 2000, LeaseAction::Hold);
    let series = bench.series_with(90, |scans| match scans {
        10 => Some(accepted),
        40 => Some(refused),
        70 => Some(home),
        _ => None,
    })?;
    let acked = |id| series.acks.iter().find(|(of, ..)| *of == id).map(|(.., scans)| *scans);
    let [Some(first), Some(last)] = [acked(accepted.id), acked(home.id)] else {
        return Err(Broken::Skip("no ACK tells when the command arrived: see steer-accepted".into()));
    };
    for (k, taken) in series.scans.iter().enumerate() {
        let allowed = match k {
            _ if k < first => continue, // whatever was applied before
            _ if k < first + LATE => [None, Some(accepted.id)],
            _ if k < last => [Some(accepted.id); 2],
            _ if k < last + LATE => [Some(accepted.id), Some(home.id)],
            _ => [Some(home.id); 2],
        };
        let stated = taken.scan.applied;
        let before = k < first + LATE && stated != Some(home.id) && stated != Some(refused.id);
        if !before && !allowed.contains(&stated) {
            return fail(
                format!("scan {} states {stated:?}", taken.scan.sequence),
                format!("{:?}: the last accepted command before it", allowed[1]),
            );
        }
    }
    Ok("the last accepted command in each scan".into())
}
