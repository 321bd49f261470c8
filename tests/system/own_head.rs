//! A twin with a head of its own, and the estimator that does not know it.

use std::path::Path;

use trifacet_wire::Status;

use crate::testkit::{self, Board, Daemon, Folder, Frame, calibrated_twin, on};

fn real_head() -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/real-head.toml")).unwrap()
}

/// A slow motion over half a millimetre and some milliradians on all axes.
const MOTION: &str = "
[[twin.motion]]
axis = \"tx\"
kind = \"sine\"
amount_um = 500.0
frequency_hz = 0.5
[[twin.motion]]
axis = \"ty\"
kind = \"sine\"
amount_um = 500.0
frequency_hz = 0.35
[[twin.motion]]
axis = \"roll\"
kind = \"sine\"
amount_urad = 3000.0
frequency_hz = 0.45
[[twin.motion]]
axis = \"yaw\"
kind = \"sine\"
amount_urad = 3000.0
frequency_hz = 0.55
";

/// rms of an axis: error of the pose relative to the first one, and stated standard uncertainty; micrometres.
struct Wrong {
    error_um: f64,
    stated_um: f64,
}

/// Runs the loop in simulation and compares the recorded poses with the true ones.
fn wrong(config: &str) -> Wrong {
    let folder = Folder::new();
    let file = folder.write("twin.toml", config);
    let simulated = |more: &[&str]| {
        let mut command = testkit::trifacet(&["simulate", "--closed-loop", "--samples", "4000"]);
        let done = command.args(more).arg("--config").arg(&file).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        String::from_utf8(done.stdout).unwrap()
    };
    let table = simulated(&[]);
    let recording = folder.path("poses.mcap");
    simulated(&["--record", recording.to_str().unwrap()]);
    let frames = on(&["export", "--format", "csv", "--output", "-"], &recording).out;
    let stated = column(&frames, "sd_tx_m");
    let status = texts(&frames, "status");
    assert!(status.iter().all(|status| status.contains("UNCALIBRATED") && status.contains("SIMULATED")));
    let (truth, found) = (column(&table, "true_tx_m"), column(&table, "tx_m"));
    assert_eq!(truth.len(), 4000);
    // Once the loop has locked.
    let settled = 300..truth.len();
    let error = |k: usize| (found[k] - found[300]) - (truth[k] - truth[300]);
    let mean = |of: &dyn Fn(usize) -> f64| settled.clone().map(of).sum::<f64>() / settled.len() as f64;
    Wrong {
        error_um: mean(&|k| error(k).powi(2)).sqrt() * 1e6,
        stated_um: mean(&|k| stated[k].powi(2)).sqrt() * 1e6,
    }
}

fn texts(table: &str, name: &str) -> Vec<String> {
    let mut table = csv::Reader::from_reader(table.as_bytes());
    let place = table.headers().unwrap().iter().position(|h| h == name).unwrap();
    table.records().map(|row| row.unwrap()[place].to_owned()).collect()
}

fn column(table: &str, name: &str) -> Vec<f64> {
    texts(table, name).iter().map(|text| text.parse().unwrap()).collect()
}

#[test]
fn an_uncalibrated_estimator_is_wrong_by_far_more_than_it_states_and_says_uncalibrated() {
    let moving = real_head().replace("motion = []", "") + MOTION;
    let Wrong { error_um, stated_um } = wrong(&moving);
    assert!((15.0..60.0).contains(&error_um), "{error_um} um");
    assert!((0.8..1.3).contains(&stated_um), "{stated_um} um: random only");
    // The same motion and the same estimator, with the head that the estimator believes.
    let (ideal, _) = moving.split_once("[twin.tolerances]").unwrap();
    let Wrong { error_um, stated_um } = wrong(&(ideal.to_owned() + MOTION));
    assert!(error_um < 1.8 * stated_um, "{error_um} {stated_um}");
}

#[test]
fn check_states_the_head_and_refuses_one_whose_light_misses_a_psd() {
    let folder = Folder::new();
    let done = on(&["check", "--config"], &folder.write("real.toml", real_head()));
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(
        done.out.contains("with a head of its own, which the estimator does not know: seed 7"),
        "{}",
        done.out
    );
    assert!(done.out.contains("rises by 0.1 K") && done.out.contains("UNCALIBRATED"), "{}", done.out);
    for (text, said) in [
        (
            "[twin.tolerances]\npsd_bow_um = [150, 60]\n",
            "twin.tolerances.psd_bow_um = [150, 60]: allowed is the smaller number first",
        ),
        (
            "[twin.head]\npsd_size_mm = 12.0\n",
            "twin.head.psd_size_mm = 12.0: allowed is head.psd_size_mm, 13",
        ),
        (
            "[twin.head.b]\npsd_origin_mm = [-125, 216.5, 20]\n",
            "twin.head: with the mirror at rest the light of facet B",
        ),
        ("[twin.psd.c]\ngain = [1.0, 1.0, -1.0]\n", "twin.psd.c.gain"),
        ("[twin.head]\nseed = 3\n", "twin.head.seed is not a key of this section"),
    ] {
        let done = on(&["check", "--config"], &folder.write("bad.toml", text));
        assert_eq!(done.code, 78, "{text}: {}", done.out);
        assert!(done.err.contains(said), "{text}: {}", done.err);
    }
}

#[test]
fn a_calibration_does_not_change_the_readings_of_the_twin_only_what_is_made_of_them() {
    let folder = Folder::new();
    let uncalibrated = folder.write("uncalibrated.toml", real_head());
    folder.write(
        "psd-b.csv",
        "u_m,v_m,du_m,dv_m\n-7e-3,-7e-3,1e-5,0\n7e-3,-7e-3,1e-5,0\n-7e-3,7e-3,1e-5,0\n7e-3,7e-3,1e-5,0\n",
    );
    let keys = "[head]\nbeam_diameter_mm = 0.48\n[head.b]\npsd_origin_mm = [-125.5, 216.2, 0.3]\n\
                [channels.b]\ngain = [1.0, 1.0, 0.97]\ncorrection = \"psd-b.csv\"\n";
    let calibrated = folder.write("calibrated.toml", real_head() + keys);
    let simulated = |file: &Path, more: &[&str]| {
        let mut command = testkit::trifacet(&["simulate", "--samples", "200"]);
        let done = command.args(more).arg("--config").arg(file).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        String::from_utf8(done.stdout).unwrap()
    };
    let readings = simulated(&uncalibrated, &[]);
    assert!(readings == simulated(&calibrated, &["--readings"]));
    let corrected = simulated(&calibrated, &[]);
    for (name, ratio, shift) in [("u_b_m", 1.0, 1e-5), ("u_a_m", 1.0, 0.0), ("power_b", 0.97, 0.0)] {
        let (before, after) = (column(&readings, name), column(&corrected, name));
        let near = |(a, b): (&f64, &f64)| (a * ratio + shift - b).abs() < 1e-12;
        assert!(before.iter().zip(&after).all(near), "{name}: {} {}", before[0], after[0]);
    }
    // In the loop, the readings are those of the same scans.
    let looped = simulated(&uncalibrated, &["--closed-loop", "--readings"]);
    assert_eq!(column(&looped, "u_b_m")[0], column(&readings, "u_b_m")[0]);
}

#[test]
fn a_daemon_on_an_emulated_board_with_a_head_of_its_own_follows_its_mirror() {
    let mut board = Board::start(&real_head()).steered_within(1500.0);
    let settings =
        "channels.readback_um_per_v = 200.0\nsteering.full_scale_um = 2000.0\nsteering.limit_um = 1500.0\n";
    let mut daemon = Daemon::on_port(&board.link(), settings);
    let mut stream = daemon.client().steered_within(1500.0);
    let before = stream.locked();
    for bit in [Status::UNCALIBRATED, Status::SIMULATED] {
        assert!(before.status.has(bit), "{before:?}");
    }
    board.order("pose 600 -400 0 0 0 2000 0.5");
    let moved = |frame: &Frame, axis: usize| (frame.pose[axis] - before.pose[axis]) * 1e6;
    let after = stream.until("the mirror is there", |frame| {
        let there = (0..2).all(|axis| (moved(frame, axis) - [600.0, -400.0][axis]).abs() < 60.0);
        there && (moved(frame, 5) - 2000.0).abs() < 200.0
    });
    assert!(after.status.has(Status::UNCALIBRATED), "{after:?}");
    board.until(|status| (status["mirror"][0].as_f64().unwrap() - 600e-6).abs() < 1e-12);
}

/// The whole way by commands, with few points.
#[test]
fn a_rough_head_is_calibrated_by_commands_and_its_poses_are_then_true() {
    let calibrated = std::fs::read_to_string(calibrated_twin().path("calibrated/trifacet.toml")).unwrap();
    let quiet = "[twin]\nspot_noise_um = 0.0\npower_noise = 0.0\nconverter_bits = 24\n";
    let moving = calibrated.replace("motion = []", "").replace("[twin]\n", quiet) + MOTION;
    let file = calibrated_twin().write("calibrated/moving.toml", moving);
    let done = on(&["simulate", "--closed-loop", "--samples", "4000", "--config"], &file);
    assert_eq!(done.code, 0, "{}", done.err);
    let status = texts(&done.out, "status");
    assert!(status.iter().skip(300).all(|status| !status.contains("INCONSISTENT")), "{:?}", status.last());
    for (axis, limit) in
        [("tx_m", 1e-6), ("ty_m", 1e-6), ("tz_m", 1e-6), ("roll_rad", 3e-6), ("yaw_rad", 3e-6)]
    {
        let (truth, found) = (column(&done.out, &format!("true_{axis}")), column(&done.out, axis));
        // The poses are those of the stage in its axes, without a tare.
        let square = (300..truth.len()).map(|k| (found[k] - truth[k]).powi(2)).sum::<f64>();
        let rms = (square / (truth.len() - 300) as f64).sqrt();
        assert!(rms < limit, "{axis}: {rms:e}");
    }
}
