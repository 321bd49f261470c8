//! A healthy sensor raises no alarm: the twin with its closed loop and with the clock of a board, sample after sample.
//!
//! Short with the other tests; ten million samples of each setting, and the table of `docs/honesty.md`, with
//!
//! ```text
//! cargo test --release --test numeric false_alarms::whole -- --ignored --nocapture
//! ```

use std::sync::Mutex;

use rand::SeedableRng;
use rand_distr::{Distribution, Exp1};
use rand_pcg::Pcg64Mcg;
use trifacet::acquisition::timebase::{ScanCounters, Timebase};
use trifacet::config::{CalibrationContext, Config, parse};
use trifacet::core::pipeline::Pipeline;
use trifacet::core::stamp::Stamp;
use trifacet::core::steering::codes;
use trifacet::core::time::Mono;
use trifacet::twin::{OUTPUT_BITS, Outputs, Twin};
use trifacet_wire::Status;
use trifacet_wire::actuator::{Ack, OutputCommand};

/// The flags that a healthy sensor must not raise.
const FLAGS: [(&str, Status); 5] = [
    ("CHANNEL_FROZEN", Status::CHANNEL_FROZEN),
    ("POWER_NOISY", Status::POWER_NOISY),
    ("POWER_STEP", Status::POWER_STEP),
    ("INCONSISTENT", Status::INCONSISTENT),
    ("CLOCK_UNSYNCED", Status::CLOCK_UNSYNCED),
];
/// Name, and configuration.
const SETTINGS: [(&str, &str); 8] = [
    ("at rest", "twin.motion = []"),
    ("moving", ""),
    ("at rest, the laser drifts by 1 um", "twin.motion = []\ntwin.pointing_um = 1\ntwin.pointing_s = 10"),
    ("moving, the laser drifts by 1 um", "twin.pointing_um = 1\ntwin.pointing_s = 10"),
    ("vibrating, 20 um at 200 Hz", VIBRATING),
    ("flicker of 5 % at 100 Hz", FLICKERING),
    ("multiplexed, moving", MULTIPLEXED),
    ("multiplexed, vibrating, flicker", ""),
];
const VIBRATING: &str = "twin.motion = [{ axis = 'tx', kind = 'sine', amount_um = 20, frequency_hz = 200 }]";
const FLICKERING: &str = "twin.fault = [{ at_s = 0, kind = 'flicker', fraction = 0.05, frequency_hz = 100 }]";
const MULTIPLEXED: &str = "twin.channel_skew_us = 20";
const BITS: [u8; 3] = [12, 16, 18];
/// The samples of the begin are not counted: flicker is refused until it is known.
const BEGIN: u64 = 1000;
/// Ticks per second of the board's clock, which gains 20 ppm.
const TICK_HZ: u32 = 1_000_000;
const GAIN: f64 = 20e-6;
/// Mean delay of a scan on its way, beyond the shortest one, seconds.
const DELAY_S: f64 = 100e-6;

/// The twin behind the clock of a board, and the pipeline of the daemon.
struct Sensor {
    twin: Twin,
    outputs: Outputs,
    pipeline: Pipeline,
    full_scale: f64,
    timebase: Timebase,
    random: Pcg64Mcg,
    last_arrival: Mono,
}

impl Sensor {
    fn new(config: &Config) -> Self {
        let context = CalibrationContext::read(config.clone()).unwrap();
        let twin = Twin::new(config).unwrap();
        let mut pipeline = config.pipeline(&context).unwrap();
        pipeline.source(twin.identity().clone().into(), Mono(0)).unwrap();
        Self {
            outputs: twin.outputs().clone(),
            timebase: Timebase::new(TICK_HZ, twin.identity().rate_hz, 0, None),
            twin,
            pipeline,
            full_scale: config.steering.full_scale_um * 1e-6,
            random: Pcg64Mcg::seed_from_u64(11),
            last_arrival: Mono(0),
        }
    }

    /// The status of the next frame.
    fn status(&mut self) -> Status {
        let scan = self.twin.next_scan();
        let late: f64 = Exp1.sample(&mut self.random);
        let arrival = Mono(((scan.t_s + DELAY_S * late) * 1e9) as i64).max(self.last_arrival);
        self.last_arrival = arrival;
        let tick = (scan.t_s * (1.0 + GAIN) * f64::from(TICK_HZ)) as u64;
        let moment = self.timebase.moment(ScanCounters { tick, periods: 1 }, arrival);
        let mut arrived = scan.arrived(moment.time, 0).unwrap();
        arrived.time_sigma_ns = Some(moment.sigma_ns);
        let step = self.pipeline.scan(&arrived, arrival).unwrap();
        if let Some(command) = step.command {
            let codes = codes(command.position, self.full_scale, OUTPUT_BITS);
            let (id, lease_ms, on_expiry) = (command.id, command.lease_ms, command.on_expiry);
            let accepted = self.outputs.take(&OutputCommand { id, codes, lease_ms, on_expiry }, arrival);
            assert!(accepted, "{command:?}");
            self.twin.steer(codes, scan.t_s);
            self.pipeline.centering().stage_answers(Ack { id, accepted });
        }
        let report = step.report.unwrap();
        let stamp = Stamp { time_ns: report.time.0, synced: true, sent: arrival, ..Stamp::example() };
        report.frame(stamp).status
    }
}

/// How often each flag was raised, and the number of frames without a pose.
#[derive(Clone, Copy, Debug, Default)]
struct Alarms {
    onsets: [u64; FLAGS.len()],
    without_pose: u64,
}

fn alarms(config: &str, samples: u64) -> Alarms {
    let mut sensor = Sensor::new(&parse(config, None).unwrap());
    let (mut alarms, mut last) = (Alarms::default(), Status::default());
    for k in 0..BEGIN + samples {
        let status = sensor.status();
        if k >= BEGIN {
            for (onsets, (_, flag)) in alarms.onsets.iter_mut().zip(FLAGS) {
                *onsets += u64::from(status.has(flag) && !last.has(flag));
            }
            alarms.without_pose += u64::from(!status.has(Status::POSE_VALID));
        }
        last = status;
    }
    alarms
}

/// Runs this number of samples with each setting, two settings at a time, and prints the table. Each flag may be raised
/// this often in each setting.
fn run(samples: u64, most: u64) {
    let all: Vec<(String, String)> = BITS
        .into_iter()
        .flat_map(|bits| {
            SETTINGS.map(|(name, config)| {
                let config = match name {
                    "multiplexed, vibrating, flicker" => format!("{VIBRATING}\n{FLICKERING}\n{MULTIPLEXED}"),
                    _ => config.to_owned(),
                };
                (format!("{bits} bits, {name}"), format!("twin.converter_bits = {bits}\n{config}\n"))
            })
        })
        .collect();
    let (next, done) = (Mutex::new(all.iter().enumerate()), Mutex::new(vec![None; all.len()]));
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let Some((i, (_, config))) = next.lock().unwrap().next() else { return };
                    let seen = alarms(config, samples);
                    println!("{}: {seen:?}", all[i].0);
                    done.lock().unwrap()[i] = Some(seen);
                }
            });
        }
    });
    println!(
        "| {samples} samples | {} | frames without a pose |",
        FLAGS.map(|(name, _)| format!("`{name}`")).join(" | ")
    );
    let done: Vec<Alarms> = done.into_inner().unwrap().into_iter().map(Option::unwrap).collect();
    for ((name, _), Alarms { onsets, without_pose }) in all.iter().zip(&done) {
        println!("| {name} | {} | {without_pose} |", onsets.map(|n| n.to_string()).join(" | "));
    }
    for ((name, _), Alarms { onsets, .. }) in all.iter().zip(&done) {
        assert!(onsets.iter().all(|&n| n <= most), "{name}: {onsets:?}");
    }
}

#[test]
fn a_healthy_sensor_raises_no_alarm() {
    run(10_000, 0);
}

#[test]
#[ignore = "a command: takes an hour or two"]
fn whole() {
    run(10_000_000, 1);
}
