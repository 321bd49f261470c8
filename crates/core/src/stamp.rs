//! Conversion of a report to a pose frame.

use nalgebra::Matrix6;
use trifacet_optics::Pose;
use trifacet_wire::frame::CLOCK_UNKNOWN;
use trifacet_wire::{PoseFrame, Status};

use crate::estimation::PoseReport;
use crate::time::Mono;

/// Largest standard uncertainty of a measurement time that can be relied upon, nanoseconds: beyond it,
/// `clock_quality` nears the end of its range.
const RELIABLE_NS: f64 = 5e6;

/// The fields of a frame besides the report: sender, number and times.
#[derive(Clone, Copy, Debug)]
pub struct Stamp {
    /// As in [`PoseFrame::session`].
    pub session: u32,
    /// As in [`PoseFrame::config`].
    pub config: u32,
    /// As in [`PoseFrame::sequence`].
    pub sequence: u64,
    /// The report's time in nanoseconds of UTC since 1970.
    pub time_ns: i64,
    /// Whether `time_ns` agrees with the system clock (else `CLOCK_UNSYNCED`).
    pub synced: bool,
    /// The time of sending.
    pub sent: Mono,
}

impl Stamp {
    /// A stamp with small numbers, for examples and tests.
    pub fn example() -> Self {
        Self { session: 7, config: 8, sequence: 9, time_ns: 10, synced: true, sent: Mono(1_090_000) }
    }
}

impl PoseReport {
    /// The frame of this report. An unknown value becomes NaN. The frame has a pose exactly if it has
    /// `POSE_VALID`.
    pub fn frame(&self, stamp: Stamp) -> PoseFrame {
        let report = self;
        let pose = report.pose.filter(|_| report.status.has(Status::POSE_VALID));
        let mut status = report.status;
        if pose.is_none() {
            status.0 &= !Status::POSE_VALID.0;
        }
        let unreliable = report.time_sigma_ns.is_some_and(|sigma_ns| sigma_ns > RELIABLE_NS);
        status.set(Status::CLOCK_UNSYNCED, !stamp.synced || unreliable);
        let roots = |covariance: Option<Matrix6<f64>>| {
            let variances = pose.and(covariance).map(|c| c.diagonal());
            variances.map_or([f32::NAN; 6], |v| std::array::from_fn(|i| v[i].sqrt() as f32))
        };
        PoseFrame {
            session: stamp.session,
            config: stamp.config,
            sequence: stamp.sequence,
            sample_index: report.index,
            time_ns: stamp.time_ns,
            solve_delay_ns: delay_ns(report.solved - report.time),
            send_delay_ns: delay_ns(stamp.sent - report.time),
            status,
            clock_quality: clock_quality(report.time_sigma_ns),
            lock: report.lock,
            iterations: report.iterations,
            pose: pose.map_or([f64::NAN; 6], Pose::to_array),
            deviations: roots(report.covariance),
            systematic: report.systematic.map(|_| roots(report.systematic)),
            beam_offset: report.offset.map_or([f32::NAN; 2], |o| o.map(|x| x as f32)),
            steering_residual: report.steering_residual.map_or(f32::NAN, |x| x as f32),
            averaged: report.averaged,
            lost: u16::try_from(report.lost).unwrap_or(u16::MAX),
            spots: report.spots.map(|x| x as f32),
            powers: report.powers.map(|x| x as f32),
            steering: report.steering.map_or([f32::NAN; 2], |s| s.map(|x| x as f32)),
        }
    }
}

fn delay_ns(ns: i64) -> u32 {
    ns.clamp(0, i64::from(u32::MAX)) as u32
}

fn clock_quality(sigma_ns: Option<f64>) -> u16 {
    sigma_ns
        .filter(|s| s.is_finite())
        .map_or(CLOCK_UNKNOWN, |s| (s / 100.0).round().clamp(0.0, f64::from(CLOCK_UNKNOWN - 1)) as u16)
}

#[cfg(test)]
mod tests {

    use super::*;

    #[test]
    fn a_report_becomes_a_frame() {
        let frame = PoseReport::example().frame(Stamp::example());
        assert_eq!(frame.pose, PoseReport::example().pose.unwrap().to_array());
        assert_eq!(frame.deviations, [2e-6; 6]);
        assert_eq!((frame.solve_delay_ns, frame.send_delay_ns), (80_000, 90_000));
        assert_eq!(frame.clock_quality, 18);
        assert_eq!(frame.status, PoseReport::example().status);
        assert_eq!((frame.session, frame.config, frame.sequence, frame.time_ns), (7, 8, 9, 10));
    }

    #[test]
    fn unknown_numbers_are_nan_and_only_a_valid_frame_has_a_pose() {
        let unknown = PoseReport {
            pose: None,
            offset: None,
            steering: None,
            steering_residual: None,
            ..PoseReport::example()
        };
        let not_valid = PoseReport { status: Status::OUT_OF_RANGE, ..PoseReport::example() };
        for report in [unknown, not_valid] {
            let frame = report.frame(Stamp::example());
            assert!(!frame.status.has(Status::POSE_VALID));
            assert!(frame.pose.iter().all(|x| x.is_nan()), "{frame:?}");
            assert!(frame.deviations.iter().all(|x| x.is_nan()), "{frame:?}");
        }
        let frame = unknown.frame(Stamp::example());
        let rest = [frame.beam_offset, frame.steering, [frame.steering_residual; 2]];
        assert!(rest.iter().flatten().all(|x| x.is_nan()), "{frame:?}");
    }

    #[test]
    fn numbers_too_large_for_their_field_saturate() {
        let late = Stamp { sent: Mono(i64::MAX), synced: true, ..Stamp::example() };
        let report = PoseReport { lost: 70_000, time_sigma_ns: Some(1e9), ..PoseReport::example() };
        let frame = report.frame(late);
        assert_eq!(frame.send_delay_ns, u32::MAX);
        assert_eq!(frame.lost, u16::MAX);
        assert_eq!(frame.clock_quality, CLOCK_UNKNOWN - 1, "a known bad quality is not unknown");
        assert!(frame.status.has(Status::CLOCK_UNSYNCED));
        let unknown = PoseReport { time_sigma_ns: None, ..report };
        assert_eq!(unknown.frame(late).clock_quality, CLOCK_UNKNOWN);
        assert!(!unknown.frame(late).status.has(Status::CLOCK_UNSYNCED));
        assert!(unknown.frame(Stamp { synced: false, ..late }).status.has(Status::CLOCK_UNSYNCED));
    }
}
