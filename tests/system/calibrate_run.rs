//! `trifacet calibrate plan` and `run` through the binary.

use std::collections::HashSet;
use std::fs::{self, File, OpenOptions};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use rustix::process::{Pid, Signal, kill_process, test_kill_process};
use trifacet_optics::calibration::plan::cells;
use trifacet_optics::{Head, Model, Optics, Pose, Vec2};

use crate::testkit::{Done, Folder, Killed, Socket, run, trifacet, wait_for};

/// A head whose steering reaches every pose of a plan of 1 mm, and whose mirror is at rest.
const LAB: &str = "channels.readback_um_per_v = 200.0\n\
    steering = { limit_um = 1500.0, full_scale_um = 2000.0 }\n\
    twin = { motion = [], steering = { limit_um = 2000.0 } }\n";

const COORDINATES: [&str; 6] = ["tx_m", "ty_m", "tz_m", "roll_rad", "pitch_rad", "yaw_rad"];

/// A folder with a configuration.
struct Lab {
    folder: Folder,
    config: PathBuf,
}

impl Lab {
    fn new(text: &str) -> Self {
        let folder = Folder::new();
        let config = folder.write("lab.toml", text);
        Self { folder, config }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path(name)
    }

    fn plan(&self, name: &str, options: &[&str]) -> Done {
        run(trifacet(&["calibrate", "plan", "--out"]).arg(self.path(name)).args(options))
    }

    /// `calibrate run` with the plan of this name, into the folder of this name.
    fn measure(&self, plan: &str, out: &str, options: &[&str]) -> Command {
        let mut command = trifacet(&["calibrate", "run", "--config"]);
        command.arg(&self.config).arg("--plan").arg(self.path(plan)).arg("--out").arg(self.path(out));
        command.args(options);
        command
    }

    /// A plan of poses that differ by less than noise, so that a mirror at rest is at all of them.
    fn poses_at_rest(&self, name: &str, count: usize) {
        let rows = "point,1e-9,0,0,0,0,0\n".repeat(count);
        self.folder.write(name, format!("kind,{}\n{rows}", COORDINATES.join(",")));
    }
}

/// The rows of a table, with a column by its name.
struct Table {
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    fn parse(text: &str) -> Self {
        let mut rows = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
        Self { columns: rows.next().unwrap(), rows: rows.collect() }
    }

    fn read(path: &Path) -> Self {
        Self::parse(&fs::read_to_string(path).unwrap())
    }

    fn texts(&self, column: &str) -> Vec<&str> {
        let place = self.columns.iter().position(|name| name == column).unwrap_or_else(|| panic!("{column}"));
        self.rows.iter().map(|row| row[place].as_str()).collect()
    }

    fn numbers(&self, column: &str) -> Vec<f64> {
        self.texts(column).iter().map(|text| text.parse().unwrap()).collect()
    }

    fn poses(&self) -> Vec<Pose> {
        let columns = COORDINATES.map(|name| self.numbers(name));
        (0..self.rows.len()).map(|k| Pose::from_array([0, 1, 2, 3, 4, 5].map(|i| columns[i][k]))).collect()
    }
}

fn cells_hit(poses: &[Pose]) -> usize {
    let optics = Optics::new(&Head::default());
    let mut hit: [HashSet<[i32; 2]>; 3] = Default::default();
    for pose in poses {
        let spots = optics.trace(Model::Gaussian, pose, Vec2::zeros()).unwrap().spots;
        hit.iter_mut().zip(cells(&spots)).for_each(|(hit, cell)| _ = hit.insert(cell));
    }
    hit.iter().map(HashSet::len).sum()
}

/// The number after this word in the expected uncertainty.
fn expected(text: &str, word: &str) -> f64 {
    let (_, expected) = text.split_once("standard uncertainty of ").unwrap_or_else(|| panic!("{text}"));
    let (_, number) = expected.split_once(word).unwrap();
    number.split([',', ' ']).next().unwrap().parse().unwrap()
}

#[test]
fn a_plan_covers_the_psds_better_than_chance_and_repeats_by_its_seed() {
    let lab = Lab::new(LAB);
    let options = ["--points", "200", "--range-mm", "1", "--range-mrad", "5"];
    let done = lab.plan("plan.csv", &options);
    assert_eq!(done.code, 0, "{}", done.err);
    for expected in
        ["200 points and 9 visits", "PSD B: spots in ", "117 samples per point", "duration: about "]
    {
        assert!(done.out.contains(expected), "{}", done.out);
    }
    // The fit of 400 points reaches 0.09 to 0.13 um and 0.24 to 0.34 urad, that of 100 points 0.36 um and 0.9 urad.
    let (tx, pitch) = (expected(&done.out, "tx "), expected(&done.out, "pitch "));
    assert!((0.1..0.4).contains(&tx) && (0.25..1.0).contains(&pitch), "{}", done.out);
    let plan = Table::read(&lab.path("plan.csv"));
    let kinds = plan.texts("kind");
    let tares: Vec<usize> = (0..kinds.len()).filter(|k| kinds[*k] == "tare").collect();
    assert_eq!(tares, [0, 26, 52, 78, 104, 130, 156, 182, 208]);
    let poses: Vec<Pose> = plan.poses();
    // Poses at random, by a generator of no quality.
    let mut state = 1_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 * 2.0 - 1.0
    };
    let range = [1e-3, 1e-3, 1e-3, 5e-3, 5e-3, 5e-3];
    let random: Vec<Pose> = (0..200).map(|_| Pose::from_array(range.map(|x| x * uniform()))).collect();
    let (planned, chance) = (cells_hit(&poses), cells_hit(&random));
    assert!(planned as f64 > 1.2 * chance as f64, "{planned} {chance}");
    let text = |name| fs::read_to_string(lab.path(name)).unwrap();
    assert_eq!(lab.plan("again.csv", &options).code, 0);
    assert_eq!(text("plan.csv"), text("again.csv"));
    assert_eq!(lab.plan("other.csv", &[&options[..], &["--seed", "2"]].concat()).code, 0);
    assert_ne!(text("plan.csv"), text("other.csv"));
    // A coarse reference is worth less.
    let coarse =
        lab.plan("coarse.csv", &[&options[..], &["--reference-um", "1", "--reference-urad", "20"]].concat());
    assert!(expected(&coarse.out, "roll ") > 1.5 * expected(&done.out, "roll "), "{}", coarse.out);
}

#[test]
fn a_plan_that_cannot_be_measured_or_written_is_refused() {
    let lab = Lab::new("");
    lab.folder.write("there.csv", "precious");
    let config = lab.config.to_str().unwrap();
    #[rustfmt::skip]
    let cases: &[(&str, &[&str], i32, &str)] = &[
        ("there.csv", &["--points", "20"], 74, "exists already"),
        ("a.csv", &["--points", "9"], 64, "10 to 5000"),
        ("a.csv", &[], 64, "--points"),
        ("a.csv", &["--points", "20", "--range-mm", "0"], 64, "0.001 to 10"),
        ("a.csv", &["--points", "20", "--range-mrad", "nan"], 64, "0.001 to 100"),
        ("a.csv", &["--points", "20", "--reference-um", "0"], 64, "0.001 to 10000"),
        ("a.csv", &["--points", "200", "--range-mm", "10", "--range-mrad", "100"], 65, "estimation.edge_margin_mm"),
        ("no/a.csv", &["--points", "20"], 74, "no/a.csv"),
    ];
    for (file, options, code, words) in cases {
        let done = lab.plan(file, options);
        assert_eq!(done.code, *code, "{options:?}: {}", done.err);
        assert!(done.err.contains(words), "{options:?}: {}", done.err);
    }
    assert!(!lab.path("a.csv").exists() && fs::read_to_string(lab.path("there.csv")).unwrap() == "precious");
    // The default steering reaches 400 um.
    let done = lab.plan("b.csv", &["--points", "50", "--config", config]);
    assert!(done.code == 0 && done.out.contains("tx reaches only 0.3"), "{} {}", done.out, done.err);
    assert!(Table::read(&lab.path("b.csv")).numbers("ty_m").iter().all(|y| y.abs() <= 380e-6));
}

/// Root mean square of the solved poses minus the reference: translations and rotations.
fn rms_of_solved(lab: &Lab, points: &Path) -> [f64; 2] {
    let solved = run(trifacet(&["solve"]).arg(points));
    assert_eq!(solved.code, 0, "{}", solved.err);
    let (solved, points) = (Table::parse(&solved.out), Table::read(points));
    let squares = COORDINATES.map(|name| {
        let reference = points.numbers(&format!("ref_{name}"));
        let errors = solved.numbers(name).into_iter().zip(reference).map(|(x, r)| (x - r).powi(2));
        errors.sum::<f64>() / points.rows.len() as f64
    });
    assert!(lab.path("lab.toml").exists());
    [0, 3].map(|i| (squares[i..i + 3].iter().sum::<f64>() / 3.0).sqrt())
}

#[test]
fn the_twin_is_measured_by_itself() {
    let lab = Lab::new(LAB);
    assert_eq!(lab.plan("plan.csv", &["--points", "20"]).code, 0);
    let done = run(&mut lab.measure("plan.csv", "out", &[]));
    assert_eq!(done.code, 0, "{}", done.err);
    for expected in ["scan.csv: 81 positions", "the stage is parked at 0.0 0.0 um", "22 of 22 poses are in "]
    {
        assert!(done.err.contains(expected), "{}", done.err);
    }
    let file = lab.path("out/points.csv");
    let points = Table::read(&file);
    assert_eq!(points.numbers("point"), (1..=22).map(f64::from).collect::<Vec<_>>());
    // The reference: 0.1 um and 0.5 urad. The reading: 1.08 um in 120 samples or more.
    let [metres, radians] = rms_of_solved(&lab, &file);
    assert!((0.5e-7..2e-7).contains(&metres) && (2.5e-7..1e-6).contains(&radians), "{metres:e} {radians:e}");
    assert!(points.numbers("std_u_b_m").iter().all(|std| (5e-8..1.01e-7).contains(std)));
    assert!(points.numbers("ref_std_yaw_rad").iter().all(|std| *std == 5e-7));
    // The beam follows the apex.
    let (stage, planned) = (points.numbers("stage_x_m"), Table::read(&lab.path("plan.csv")).numbers("tx_m"));
    assert!(stage.iter().zip(planned).all(|(stage, tx)| (stage - tx).abs() < 5e-6));
    for name in ["out/scan.csv", "out/scan-end.csv"] {
        let scan = Table::read(&lab.path(name));
        assert_eq!(scan.rows.len(), 81);
        assert!(!scan.columns.iter().any(|name| name.starts_with("ref_")));
        let largest = scan.numbers("stage_y_m").into_iter().fold(0.0, f64::max);
        assert!((largest / 150e-6 - 1.0).abs() < 0.05, "{largest}");
        let power = scan.numbers("power_a");
        assert!(power.iter().any(|p| *p < 5e-5) && power.iter().any(|p| *p > 4e-4));
    }
    let recordings: Vec<_> =
        fs::read_dir(lab.path("out/recording")).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(recordings.len(), 1, "{recordings:?}");
    let replayed = run(trifacet(&["replay"]).arg(&recordings[0]));
    assert_eq!(replayed.code, 0, "{} {}", replayed.out, replayed.err);
}

/// Readings do not contain what a calibration determines: correction tables and power gains.
#[test]
fn readings_are_those_before_tables_and_power_gains() {
    let lab = Lab::new(LAB);
    assert_eq!(lab.plan("plan.csv", &["--points", "10", "--range-mm", "0.1", "--range-mrad", "1"]).code, 0);
    assert_eq!(run(&mut lab.measure("plan.csv", "plain", &[])).code, 0);
    let rows: String = [-6.5e-3, 6.5e-3]
        .iter()
        .flat_map(|u| [-6.5e-3, 6.5e-3].map(|v| format!("{u},{v},0.0001,-0.0001\n")))
        .collect();
    lab.folder.write("table.csv", format!("u_m,v_m,du_m,dv_m\n{rows}"));
    let channel =
        |psd| format!("channels.{psd}.correction = 'table.csv'\nchannels.{psd}.gain = [1.0, 1.0, 1.02]\n");
    let text = format!("{LAB}{}", ["a", "b", "c"].map(channel).concat());
    // The twin's amplifiers have the configured gain: its powers are divided by it.
    fs::write(&lab.config, text).unwrap();
    let done = run(&mut lab.measure("plan.csv", "calibrated", &[]));
    assert_eq!(done.code, 0, "{}", done.err);
    let [plain, other] = ["plain", "calibrated"].map(|name| Table::read(&lab.path(name).join("points.csv")));
    let mean = |table: &Table, name: &str| table.numbers(name).iter().sum::<f64>() / table.rows.len() as f64;
    assert!((mean(&plain, "u_a_m") - mean(&other, "u_a_m")).abs() < 1e-6);
    assert!((mean(&plain, "power_b") / mean(&other, "power_b") - 1.02).abs() < 0.002);
}

#[test]
fn an_interrupted_run_parks_and_continues() {
    let lab = Lab::new(&LAB.replacen("steering = {", "steering = { park_um = [50.0, -20.0],", 1));
    assert_eq!(lab.plan("plan.csv", &["--points", "80"]).code, 0);
    let mut child = lab.measure("plan.csv", "out", &[]).stderr(Stdio::piped()).spawn().unwrap();
    let file = lab.path("out/points.csv");
    let rows = || fs::read_to_string(&file).map_or(0, |text| text.lines().count());
    wait_for("a few points", || if rows() > 4 { Ok(()) } else { Err(format!("{} rows", rows())) });
    kill_process(Pid::from_child(&child), Signal::INT).unwrap();
    let mut err = String::new();
    child.stderr.take().unwrap().read_to_string(&mut err).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{err}");
    for expected in ["the stage is parked at 50.0 -20.0 um", "interrupted", "--resume continues"] {
        assert!(err.contains(expected), "{err}");
    }
    let before = fs::read_to_string(&file).unwrap();
    assert!(before.lines().count() < 86, "the interruption came too late: {err}");
    // Nothing is written over, and only the same run is continued.
    let refused = run(&mut lab.measure("plan.csv", "out", &[]));
    assert!(refused.code == 74 && refused.err.contains("is not empty"), "{}", refused.err);
    assert_eq!(lab.plan("other.csv", &["--points", "80", "--seed", "9"]).code, 0);
    let refused = run(&mut lab.measure("other.csv", "out", &["--resume"]));
    assert!(refused.code == 64 && refused.err.contains("--plan is another file"), "{}", refused.err);
    let done = run(&mut lab.measure("plan.csv", "out", &["--resume"]));
    assert_eq!(done.code, 0, "{}", done.err);
    let after = fs::read_to_string(&file).unwrap();
    assert!(after.starts_with(&before));
    let mut points: Vec<u32> =
        Table::parse(&after).texts("point").iter().map(|p| p.parse().unwrap()).collect();
    assert_eq!(points.iter().filter(|point| **point == 1).count(), 2, "the tare pose is visited again");
    points.sort_unstable();
    points.dedup();
    assert_eq!(points, (1..=85).collect::<Vec<_>>());
    assert_eq!(Table::read(&lab.path("out/scan.csv")).rows.len(), 81);
}

/// An emulated board whose commands come through a named pipe.
struct EmulatedHead {
    _board: Killed,
    orders: PathBuf,
    link: PathBuf,
}

impl EmulatedHead {
    fn start(lab: &Lab, socket: &Socket) -> Self {
        let orders = lab.path("orders");
        assert!(Command::new("mkfifo").arg(&orders).status().unwrap().success());
        // Open for reading and writing, so that it stays open between two commands.
        let stdin = OpenOptions::new().read(true).write(true).open(&orders).unwrap();
        let mut board = trifacet(&["emulate", "--link"])
            .arg(socket.link())
            .arg("--config")
            .arg(&lab.config)
            .stdin(stdin)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(board.stdout.take().unwrap()).read_line(&mut line).unwrap();
        assert!(line.starts_with("/dev/pts/"), "{line}");
        Self { _board: Killed(board), orders, link: socket.link() }
    }
}

#[test]
fn a_program_moves_the_stage_of_a_board_point_by_point() {
    let lab = Lab::new(LAB);
    let (socket, emulated) = (Socket::new(), Lab::new(LAB));
    let head = EmulatedHead::start(&emulated, &socket);
    let text = format!(
        "{LAB}acquisition = {{ source = 'serial', serial = {{ port = '{}' }} }}\n",
        head.link.display()
    );
    fs::write(&lab.config, text).unwrap();
    // Metres and radians to micrometres and microradians, a move of 0.3 s, and the pose as the answer.
    let script = "out=$1; shift; echo \"$*\" | awk '{ printf \"pose\"; for (i = 1; i <= 6; i++) printf \" %.9f\", $i * 1e6; \
                  print \" 0.3\" }' > \"$out\"; sleep 0.5; echo moved; echo \"$*\"";
    let orders = head.orders.to_str().unwrap();
    assert_eq!(lab.plan("plan.csv", &["--points", "10", "--range-mm", "0.2", "--range-mrad", "1"]).code, 0);
    let places = COORDINATES.map(|name| format!("{{{name}}}"));
    let mut command =
        lab.measure("plan.csv", "out", &["--reference", "command", "--", "sh", "-c", script, "stage"]);
    let done = run(command.arg(orders).args(places));
    assert_eq!(done.code, 0, "{}", done.err);
    let points = lab.path("out/points.csv");
    assert_eq!(Table::read(&points).rows.len(), 12);
    // The stage is exact here: what is left is the noise of the reading.
    let [metres, radians] = rms_of_solved(&lab, &points);
    assert!(metres < 1.5e-7 && radians < 4e-7, "{metres:e} {radians:e}");
    assert_eq!(Table::read(&lab.path("out/scan.csv")).rows.len(), 81);
}

#[test]
fn a_file_and_a_pipe_answer_the_poses() {
    let lab = Lab::new(LAB);
    lab.poses_at_rest("plan.csv", 3);
    let row = |x: f64| format!("{x:e},0,0,0,0,0\n");
    // The third line is appended while the run waits for it.
    let text = format!("{}\n# stage of the lab\n{}{}", COORDINATES.join(","), row(1e-9), row(2e-9));
    let poses = lab.folder.write("poses.csv", text);
    let reference = format!("file:{}", poses.display());
    let command = &mut lab.measure("plan.csv", "file", &["--reference", &reference]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let asked = BufReader::new(child.stdout.take().unwrap()).lines();
    for (number, line) in asked.map(Result::unwrap).enumerate() {
        assert_eq!(line, "point,1e-9,0e0,0e0,0e0,0e0,0e0");
        if number == 2 {
            OpenOptions::new().append(true).open(&poses).unwrap().write_all(row(3e-9).as_bytes()).unwrap();
        }
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(Table::read(&lab.path("file/points.csv")).numbers("ref_tx_m"), [1e-9, 2e-9, 3e-9]);

    // Through standard input, with a coordinate that is measured alone.
    let mut command = lab.measure("plan.csv", "pipe", &["--reference", "pipe:-"]);
    let answers = format!("{}0 - - - - -\n{}", row(1e-9), row(3e-9));
    let done = with_input(&mut command, &answers);
    assert_eq!(done.code, 0, "{}", done.err);
    let points = Table::read(&lab.path("pipe/points.csv"));
    assert_eq!(points.texts("ref_ty_m"), ["0e0", "", "0e0"]);
    assert_eq!(points.texts("ref_std_ty_m"), ["1e-7", "", "1e-7"]);

    // Through a named pipe, which is opened for each answer.
    let fifo = lab.path("fifo");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let reference = format!("pipe:{}", fifo.display());
    let command = &mut lab.measure("plan.csv", "fifo-run", &["--reference", &reference]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    for _ in BufReader::new(child.stdout.take().unwrap()).lines() {
        File::options().write(true).open(&fifo).unwrap().write_all(row(1e-9).as_bytes()).unwrap();
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(Table::read(&lab.path("fifo-run/points.csv")).rows.len(), 3);
}

fn with_input(command: &mut Command, input: &str) -> Done {
    let mut child =
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Done { code: output.status.code().unwrap(), out: text(output.stdout), err: text(output.stderr) }
}

#[test]
fn an_operator_confirms_repeats_and_omits_poses() {
    let lab = Lab::new(LAB);
    lab.poses_at_rest("plan.csv", 3);
    let options = ["--reference", "manual"];
    // A wrong answer is asked again; the second pose is omitted.
    let done = with_input(&mut lab.measure("plan.csv", "out", &options), "there\n0.5 0 0 0 0 0\ns\nok\n");
    assert_eq!(done.code, 65, "{}", done.err);
    for expected in ["pose 1 of 3", "1 fields where six numbers", "not measured: poses 2", "parked"] {
        assert!(done.err.contains(expected), "{}", done.err);
    }
    let points = Table::read(&lab.path("out/points.csv"));
    assert_eq!((points.texts("point"), points.texts("ref_tx_m")), (vec!["1", "3"], vec!["5e-7", "1e-9"]));
    let done = with_input(&mut lab.measure("plan.csv", "out", &["--reference", "manual", "--resume"]), "\n");
    assert_eq!(done.code, 0, "{}", done.err);
    assert_eq!(Table::read(&lab.path("out/points.csv")).texts("point"), ["1", "3", "2"]);
    let done = with_input(&mut lab.measure("plan.csv", "stopped", &options), "\nq\n");
    assert_eq!(done.code, 130, "{}", done.err);
    let done = with_input(&mut lab.measure("plan.csv", "ended", &options), "\n");
    assert!(done.code == 65 && done.err.contains("the input has ended"), "{}", done.err);
}

#[test]
fn a_mirror_that_never_rests_is_named_with_its_axis() {
    let shaking = LAB.replace(
        "motion = []",
        "motion = [{ axis = 'roll', kind = 'sine', amount_urad = 30.0, frequency_hz = 2.0 }]",
    );
    let lab = Lab::new(&shaking);
    lab.poses_at_rest("plan.csv", 2);
    let options = ["--reference", "manual", "--rest-timeout", "2"];
    let done = with_input(&mut lab.measure("plan.csv", "out", &options), "\n\ns\n\ns\n");
    assert_eq!(done.code, 65, "{}", done.err);
    assert_eq!(done.err.matches("point 1: the mirror is not at rest after 2 s").count(), 2, "{}", done.err);
    assert!(done.err.contains("of PSD ") && done.err.contains("mostly roll moves, by "), "{}", done.err);
    // Nobody can be asked: the poses are omitted by themselves.
    let reference = lab.folder.write("poses.csv", "0 0 0 0 0 0\n0 0 0 0 0 0\n");
    let reference = format!("file:{}", reference.display());
    let options = ["--reference", &reference, "--rest-timeout", "2"];
    let done = run(&mut lab.measure("plan.csv", "file", &options));
    assert!(done.code == 65 && done.err.contains("not measured: poses 1, 2"), "{}", done.err);
}

#[test]
fn a_head_without_light_is_reported_and_the_run_ends() {
    let lab = Lab::new(
        &LAB.replace("motion = []", "motion = [], fault = [{ at_s = 1.0, kind = 'psd-dark', psd = 1 }]"),
    );
    assert_eq!(lab.plan("plan.csv", &["--points", "10"]).code, 0);
    let done = run(&mut lab.measure("plan.csv", "out", &["--rest-timeout", "1"]));
    assert_eq!(done.code, 69, "{}", done.err);
    assert!(done.err.contains("PSD B receives too little light"), "{}", done.err);
    assert!(
        done.err.contains("3 poses in a row have no reading") && done.err.contains("parked"),
        "{}",
        done.err
    );
}

#[test]
fn unusable_answers_are_named_with_their_point() {
    let lab = Lab::new(LAB);
    lab.poses_at_rest("plan.csv", 2);
    let pid = lab.path("pid");
    let sleeper = format!("echo $$ > {}; exec sleep 1000", pid.display());
    #[rustfmt::skip]
    let cases: &[(&[&str], &str)] = &[
        (&["--", "echo", "hello"], "point 1: echo printed \"hello\": 1 fields where six numbers are expected"),
        (&["--", "echo", "0 0 0 0 0"], "5 fields where six numbers"),
        (&["--", "echo", "0 0 nan 0 0 0"], "tz is \"nan\": allowed is a finite number"),
        (&["--", "echo", "1.5 0 0 0 0 0"], "tx is 1.5 m: allowed is -0.05 to 0.05 m"),
        (&["--", "true"], "true printed nothing"),
        (&["--", "sh", "-c", "echo the stage is off >&2; exit 3"], "ended with exit status: 3: the stage is off"),
        (&["--", "/no/such/stage", "{tx_m}"], "cannot run /no/such/stage: No such file"),
        (&["--command-timeout", "0.3", "--", "sh", "-c", &sleeper], "has not ended after 0.3 s"),
    ];
    for (number, (options, words)) in cases.iter().enumerate() {
        let mut command = lab.measure("plan.csv", &format!("out-{number}"), &["--reference", "command"]);
        let done = run(command.args(*options));
        assert_eq!(done.code, 65, "{options:?}: {}", done.err);
        assert!(done.err.contains(words) && done.err.contains("point 1"), "{options:?}: {}", done.err);
    }
    let sleeping = Pid::from_raw(fs::read_to_string(pid).unwrap().trim().parse().unwrap()).unwrap();
    wait_for("the program ended", || test_kill_process(sleeping).map_or(Ok(()), |()| Err("it runs".into())));
    // In a file, the line is named too.
    for (text, words) in [
        ("0 0 0 0 0 0\n# a\n1 2\n", ":3: point 2: \"1 2\": 2 fields"),
        ("0 0 0 0 0 0\n1e-3 0 0 0 0 0\n", "point 2: by the reference, the spots must have moved by "),
    ] {
        let file = lab.path("poses.txt");
        fs::write(&file, text).unwrap();
        let reference = format!("file:{}", file.display());
        let out = format!("file-{}", text.len());
        let done = run(&mut lab.measure("plan.csv", &out, &["--reference", &reference]));
        assert_eq!(done.code, 65, "{}", done.err);
        assert!(done.err.contains(words) && done.err.contains("1 of 2 poses"), "{}", done.err);
    }
}

#[test]
fn a_run_that_cannot_begin_says_why() {
    let lab = Lab::new(LAB);
    lab.poses_at_rest("plan.csv", 2);
    lab.folder.write("bad.csv", "tx_m,ty_m,tz_m,roll_rad,pitch_rad,yaw_rad\n0,0,0,0,0,0\n1,0,0,0,0,0\n");
    lab.folder.write("empty.csv", "tx_m,ty_m,tz_m,roll_rad,pitch_rad,yaw_rad\n");
    #[rustfmt::skip]
    let cases: &[(&str, &[&str], i32, &str)] = &[
        ("plan.csv", &["--reference", "tape"], 64, "allowed are manual, file:PATH"),
        ("plan.csv", &["--reference", "command"], 64, "requires a program"),
        ("plan.csv", &["--", "true"], 64, "requires --reference command"),
        ("plan.csv", &["--rest-timeout", "0"], 64, "0.1 to 86400"),
        ("none.csv", &[], 74, "none.csv"),
        ("bad.csv", &[], 65, "bad.csv:3: tx_m is 1: allowed is -0.05 to 0.05 m"),
        ("empty.csv", &[], 65, "contains no pose"),
        ("plan.csv", &["--reference", "file:/no/such/file"], 74, "cannot read /no/such/file"),
    ];
    for (plan, options, code, words) in cases {
        let done = run(&mut lab.measure(plan, "out", options));
        assert_eq!(done.code, *code, "{options:?}: {}", done.err);
        assert!(done.err.contains(words), "{options:?}: {}", done.err);
        let _ = fs::remove_dir_all(lab.path("out"));
    }
    fs::write(&lab.config, "acquisition = { source = 'serial', serial = { port = '/dev/no-such-port' } }")
        .unwrap();
    let done = run(&mut lab.measure("plan.csv", "out", &["--reference", "twin"]));
    assert!(done.code == 64 && done.err.contains("acquisition.source"), "{}", done.err);
}

#[test]
fn a_second_run_in_the_same_folder_is_refused() {
    let lab = Lab::new(LAB);
    lab.poses_at_rest("plan.csv", 2);
    let child: Child = lab
        .measure("plan.csv", "out", &["--reference", "manual"])
        .stdin(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let _child = Killed(child);
    let there = || lab.path("out/points.csv").exists();
    wait_for("the run began", || if there() { Ok(()) } else { Err("no file".into()) });
    let done = run(&mut lab.measure("plan.csv", "out", &["--resume"]));
    assert!(done.code == 75 && done.err.contains("another session uses"), "{}", done.err);
}
