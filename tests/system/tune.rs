//! `trifacet tune` through the binary: on the twin, and on an emulated board.

use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use trifacet::config::{self, Config};

use crate::testkit::{Board, Daemon, Folder, Killed, trifacet};

/// A folder with a configuration.
struct Lab {
    folder: Folder,
    file: PathBuf,
    text: String,
}

impl Lab {
    fn new(text: &str) -> Self {
        let folder = Folder::new();
        let file = folder.write("lab.toml", text);
        Self { folder, file, text: text.into() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path(name)
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = trifacet(&arguments[..1]);
        command.arg("--config").arg(&self.file).args(&arguments[1..]);
        command
    }

    fn tune(&self, arguments: &[&str]) -> Output {
        self.command(&[&["tune"], arguments].concat()).output().unwrap()
    }

    fn after(&self) -> Config {
        config::load(Some(&self.file)).unwrap()
    }

    fn untouched(&self) -> bool {
        std::fs::read_to_string(&self.file).unwrap() == self.text
    }
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into()
}

/// Checks that the steering matrix is found to a percent of its size, and the delay and lag of the twin.
fn tuned(config: &Config, truth: [[f64; 2]; 2], said: &str) {
    let size = truth[0][0].hypot(truth[1][0]);
    for (found, truth) in config.steering.matrix.as_flattened().iter().zip(truth.as_flattened()) {
        assert!((found - truth).abs() < 0.01 * size, "{found} {truth}\n{said}");
    }
    let period_ms = 1e3 / config.acquisition.rate_hz;
    let centering = &config.centering;
    // The delay of the twin, plus the time from a sample to its command.
    let most = 1.2 + 1.5 * period_ms;
    assert!((0.95..most).contains(&centering.loop_delay_ms), "{said}");
    assert!((centering.lag_ms - 0.5).abs() < 0.1, "{said}");
}

/// A rotation by 120 degrees: a loop without this matrix would be unstable.
const TURNED: [[f64; 2]; 2] = [[-0.4, -0.69282], [0.69282, -0.4]];

#[test]
fn a_rotated_stage_is_measured_and_the_daemon_locks_with_the_result() {
    let lab = Lab::new(&format!(
        "# our lab\npublishing.tcp = \"off\"\npublishing.udp = []\ntwin.laser_offset_um = [30.0, -20.0]\n\
         [twin.steering] # bent\nmatrix = {TURNED:?}\n[centering]\nlag_ms = 3.0 # guessed\n"
    ));
    let plot = lab.path("steps.svg");
    let output = lab.tune(&["--steps", "40", "--plot", plot.to_str().unwrap()]);
    let said = said(&output);
    assert!(output.status.success(), "{said}");
    let config = lab.after();
    tuned(&config, TURNED, &said);
    for (found, truth) in config.steering.origin_um.iter().zip([30.0, -20.0]) {
        assert!((found - truth).abs() < 0.3, "{said}");
    }
    let text = std::fs::read_to_string(&lab.file).unwrap();
    assert!(text.starts_with("# our lab\n") && text.contains("[twin.steering] # bent\n"), "{text}");
    assert!(text.contains("# guessed\n") && !text.contains("3.0"), "{text}");
    let svg = std::fs::read_to_string(plot).unwrap();
    assert!(
        svg.starts_with("<svg ") && svg.ends_with("</svg>\n") && svg.contains("movement of the beam, um")
    );
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    locks(&lab);
}

/// Runs the daemon with the file until its loop is locked.
fn locks(lab: &Lab) {
    let mut daemon = Daemon::start(&std::fs::read_to_string(&lab.file).unwrap());
    daemon.message("control socket is open");
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
}

#[test]
fn at_ten_kilohertz_the_delay_is_that_of_the_stage() {
    let lab = Lab::new("acquisition.rate_hz = 10000.0\n");
    let output = lab.tune(&["--steps", "40"]);
    assert!(output.status.success(), "{}", said(&output));
    tuned(&lab.after(), [[1.0, 0.0], [0.0, 1.0]], &said(&output));
}

#[test]
fn print_and_dry_run_do_not_change_the_file() {
    let lab = Lab::new("centering.kp = 0.25\n");
    let output = lab.tune(&["--steps", "20", "--print"]);
    assert!(output.status.success(), "{}", said(&output));
    let text = String::from_utf8_lossy(&output.stdout);
    for key in ["[steering]\nmatrix = [[", "origin_um = [", "[centering]\nloop_delay_ms = ", "lag_ms = "] {
        assert!(text.contains(key), "{text}");
    }
    let power_uw = config::parse(&text, None).unwrap().laser.power_uw.unwrap();
    assert!((power_uw - 600.0).abs() < 1.0, "{text}");
    tuned(&config::parse(&text, None).unwrap(), [[1.0, 0.0], [0.0, 1.0]], &said(&output));
    assert!(said(&output).contains("centering.kp = 0.25, which overrides"), "{}", said(&output));
    let output = lab.tune(&["--dry-run"]);
    assert!(output.status.success() && output.stdout.is_empty(), "{output:?}");
    assert!(said(&output).contains("10.000 um to either side") && !said(&output).contains("acknowledged"));
    assert!(lab.untouched());
}

/// Configuration and options, exit code, and what the message must contain.
type Refusal = (&'static str, &'static [&'static str], i32, &'static [&'static str]);

/// Cases that are refused before the stage moves.
#[rustfmt::skip]
const REFUSED: &[Refusal] = &[
    ("twin.fault = [{ at_s = 0.0, kind = 'beam-blocked' }]", &[], 65, &["no PSD sees light"]),
    ("twin.fault = [{ at_s = 0.5, kind = 'psd-dark', psd = 1 }]", &[], 65, &["PSD B sees too little light"]),
    ("twin.fault = [{ at_s = 0.0, kind = 'clipped', channel = 8 }]", &[], 65, &["a channel of PSD C is clipped"]),
    ("twin.fault = [{ at_s = 0.0, kind = 'dropped', fraction = 0.3 }]", &[], 65, &["samples were lost", "windows of 75 ms", "at least 80"]),
    ("twin.fault = [{ at_s = 0.2, kind = 'stalled' }]", &[], 69, &["the source is down: no scan for"]),
    ("steering.limit_um = 8", &[], 65, &["would leave the limits", "from -10 to 10 um", "allows -8 to 8 um"]),
    ("twin.laser_offset_um = [120.0, 0.0]\ntwin.motion = []", &[], 65, &["um off the apex", "at most 95 um can be measured"]),
    ("twin.power_noise = 0.1", &[], 65, &["not quiet enough", "allows 5 um"]),
    ("twin.steering.readback_noise_um = 'off'", &[], 65, &["does not report its position", "--at"]),
    ("twin.steering.readback_noise_um = 'off'", &["--at", "395,0"], 65, &["would leave the limits", "405"]),
    ("", &["--at", "0,0"], 65, &["--at is for a stage without readback"]),
    ("", &["--step", "60"], 65, &["a step of 60 um", "slew_mm_per_s, 50", "allowed: 50 um"]),
    ("", &["--step", "0"], 64, &["a number above 0"]),
    ("twin.steering.readback_noise_um = 'off'\nsteering.kind = 'gcs'\nsteering.gcs.address = '127.0.0.1:1'", &[], 69, &["the stage does not take commands", "127.0.0.1:1"]),
    ("acquisition.source = 'serial'\nacquisition.serial.port = '/dev/no-such-port'", &[], 69, &["/dev/no-such-port"]),
];

#[test]
fn unsafe_conditions_are_refused_before_the_stage_moves() {
    for (text, options, code, words) in REFUSED {
        let lab = Lab::new(text);
        let output = lab.tune(options);
        let said = said(&output);
        assert_eq!(output.status.code(), Some(*code), "{text} {options:?}: {said}");
        assert!(words.iter().all(|word| said.contains(word)), "{text} {options:?}: {said}");
        assert!(!said.contains("the stage is left"), "{said}");
        assert!(output.stdout.is_empty() && lab.untouched());
    }
}

#[test]
fn a_stage_without_readback_is_measured_from_the_position_of_the_operator() {
    let lab = Lab::new("twin.steering.readback_noise_um = 'off'\n");
    let output = lab.tune(&["--steps", "20", "--at", "0,0"]);
    assert!(output.status.success(), "{}", said(&output));
    tuned(&lab.after(), [[1.0, 0.0], [0.0, 1.0]], &said(&output));
}

#[test]
fn a_stuck_stage_is_not_tuned() {
    let lab = Lab::new("twin.fault = [{ at_s = 0.0, kind = 'steering-stuck' }]\n");
    let output = lab.tune(&["--steps", "10"]);
    assert_eq!(output.status.code(), Some(65));
    assert!(
        said(&output).contains("the stage does not follow on the x axis: its readback moves by"),
        "{}",
        said(&output)
    );
    assert!(output.stdout.is_empty() && lab.untouched());
}

#[test]
fn a_stage_slower_than_the_dwell_is_refused_and_measured_with_the_advised_dwell() {
    let lab = Lab::new("twin.steering.delay_ms = 60\n");
    let output = lab.tune(&["--steps", "10"]);
    let refusal = said(&output);
    assert_eq!(output.status.code(), Some(65), "{refusal}");
    assert!(refusal.contains("the movement of the x axis begins 6"), "{refusal}");
    assert!(
        refusal.contains("too late for a dwell of 50 ms") && refusal.contains("acknowledged"),
        "{refusal}"
    );
    assert!(output.stdout.is_empty() && lab.untouched());
    let (_, dwell) = refusal.trim_end().rsplit_once("--dwell ").unwrap();
    let output = lab.tune(&["--steps", "10", "--dwell", dwell]);
    let said = said(&output);
    assert!(output.status.success(), "{said}");
    let config = lab.after();
    assert!((config.steering.matrix[0][0] - 1.0).abs() < 0.02, "{said}");
    assert!((59.5..62.0).contains(&config.centering.loop_delay_ms), "{said}");
}

#[test]
fn an_output_that_cannot_be_written_is_refused_before_the_stage_moves() {
    let lab = Lab::new("");
    let nowhere = lab.path("no-such-folder/steps.svg");
    let refused = |options: &[&str], word: &str| {
        let output = lab.tune(options);
        let said = said(&output);
        assert_eq!(output.status.code(), Some(74), "{said}");
        assert!(said.contains(word) && !said.contains("the stage"), "{said}");
        assert!(output.stdout.is_empty() && lab.untouched());
    };
    refused(&["--plot", nowhere.to_str().unwrap()], "cannot write the plot to");
    let plot = lab.path("steps.svg");
    let output = lab.tune(&["--print", "--dry-run", "--plot", plot.to_str().unwrap()]);
    assert!(output.status.success() && !plot.exists(), "{}", said(&output));
}

#[test]
fn a_loss_of_light_ends_the_command_and_the_stage_returns() {
    let lab = Lab::new("twin.fault = [{ at_s = 2.0, kind = 'beam-blocked' }]\n");
    let output = lab.tune(&["--steps", "100"]);
    assert_eq!(output.status.code(), Some(65));
    assert!(said(&output).contains("no PSD sees light"), "{}", said(&output));
    assert!(said(&output).contains("the stage is left at 0 0 um, acknowledged"), "{}", said(&output));
    assert!(lab.untouched());
}

#[test]
fn a_gap_in_the_samples_costs_a_repeated_step_and_not_the_measurement() {
    // During the first step of an axis, which is observed for a second, and during the steps after it.
    let gap = |at_s: f64| format!("{{ at_s = {at_s}, for_s = 0.06, kind = 'stalled' }}");
    let lab = Lab::new(&format!("twin.fault = [{}, {}]\n", gap(2.0), gap(5.0)));
    let output = lab.tune(&["--steps", "40"]);
    assert!(output.status.success(), "{}", said(&output));
    assert!(said(&output).contains("steps were repeated"), "{}", said(&output));
    tuned(&lab.after(), [[1.0, 0.0], [0.0, 1.0]], &said(&output));
}

#[test]
fn gaps_in_every_attempt_at_a_step_end_the_command_and_the_stage_returns() {
    let gap = |k: u32| format!("{{ at_s = {}, for_s = 0.03, kind = 'stalled' }}", 4.0 + 0.07 * f64::from(k));
    let gaps: Vec<_> = (0..400).map(gap).collect();
    let lab = Lab::new(&format!("twin.fault = [{}]\n", gaps.join(", ")));
    let output = lab.tune(&[]);
    assert_eq!(output.status.code(), Some(69), "{}", said(&output));
    assert!(
        said(&output).contains("samples stopped during each of 5 attempts at one step"),
        "{}",
        said(&output)
    );
    assert!(said(&output).contains("the stage is left at 0 0 um, acknowledged") && lab.untouched());
}

#[test]
fn a_stage_that_parks_in_a_gap_is_not_moved_on() {
    let fault = "twin.fault = [{ at_s = 2.5, for_s = 0.3, kind = 'stalled' }]\n";
    let lab = Lab::new(&format!("steering.on_lease = 'park'\nsteering.park_um = [30, 0]\n{fault}"));
    let output = lab.tune(&[]);
    assert_eq!(output.status.code(), Some(69), "{}", said(&output));
    assert!(said(&output).contains("the board has parked the stage") && lab.untouched(), "{}", said(&output));
}

/// Tunes on a board.
fn on(board: &Board, more: &str) -> Lab {
    let port = board.link();
    let port = port.display();
    Lab::new(&format!("acquisition.source = \"serial\"\nacquisition.serial.port = \"{port}\"\n{more}"))
}

#[test]
fn a_board_is_tuned_within_its_limits_and_parked() {
    // A pause of the board of five periods ends a run, as intended. At this rate, that is 50 ms.
    let mut board = Board::start(&format!("acquisition.rate_hz = 100\ntwin.steering.matrix = {TURNED:?}"));
    board = board.steered_within(15.0);
    let steering = "steering = { limit_um = 15, on_exit = \"park\", park_um = [12, -7] }\n";
    let lab = on(&board, &format!("acquisition.rate_hz = 100\n{steering}"));
    let mut tune = Killed(lab.command(&["tune", "--steps", "10"]).stderr(Stdio::piped()).spawn().unwrap());
    while tune.0.try_wait().unwrap().is_none() {
        board.status(); // within its limits
        std::thread::sleep(Duration::from_millis(20)); // between two requests
    }
    let mut said = String::new();
    std::io::Read::read_to_string(&mut tune.0.stderr.take().unwrap(), &mut said).unwrap();
    assert!(tune.0.wait().unwrap().success(), "{said}");
    let config = lab.after();
    for (found, truth) in config.steering.matrix.as_flattened().iter().zip(TURNED.as_flattened()) {
        assert!((found - truth).abs() < 0.01, "{said}");
    }
    assert!(config.centering.loop_delay_ms >= 0.95, "{said}");
    let status = board.status();
    stands_at(&status, [12.0, -7.0]);
    assert_eq!(status["commands_refused"], 0, "{status}");
}

#[test]
fn after_an_interrupt_the_stage_returns() {
    for signal in [Signal::INT, Signal::TERM] {
        let mut board = Board::start("").steered_within(10.02);
        let lab = on(&board, "");
        let mut tune = Killed(lab.command(&["tune"]).stderr(Stdio::piped()).spawn().unwrap());
        board.until(|status| status["output_um"][0].as_f64().unwrap().abs() > 5.0);
        kill_process(Pid::from_child(&tune.0), signal).unwrap();
        let mut said = String::new();
        std::io::Read::read_to_string(&mut tune.0.stderr.take().unwrap(), &mut said).unwrap();
        assert_eq!(tune.0.wait().unwrap().code(), Some(130), "{said}");
        assert!(said.contains("acknowledged\ntrifacet: interrupted"), "{said}");
        stands_at(&board.status(), [0.0, 0.0]);
        assert!(lab.untouched());
    }
}

/// Checks the outputs of the board, within the noise of the readback that determined the start position.
fn stands_at(status: &serde_json::Value, at_um: [f64; 2]) {
    for (axis, at_um) in at_um.into_iter().enumerate() {
        assert!((status["output_um"][axis].as_f64().unwrap() - at_um).abs() < 0.1, "{status}");
    }
}

#[test]
fn a_port_in_use_is_reported_with_its_process() {
    let board = Board::start("");
    let lab = on(&board, "");
    let mut first = Killed(lab.command(&["tune"]).stderr(Stdio::piped()).spawn().unwrap());
    let mut lines = std::io::BufRead::lines(std::io::BufReader::new(first.0.stderr.take().unwrap()));
    lines.find(|line| line.as_ref().unwrap().starts_with("the stage is at")).unwrap().unwrap();
    let output = lab.tune(&[]);
    assert_eq!(output.status.code(), Some(75));
    assert!(said(&output).contains(&format!("in use by process {}", first.0.id())), "{}", said(&output));
}

/// A wrong dark offset shifts the spot on PSD A by 0.5 mm, as a displaced PSD does.
#[test]
fn a_large_origin_is_written_only_on_request_and_stays_visible() {
    let lab = Lab::new("publishing.udp = []\n[twin]\ndark_v = [0.77, 0, 0, 0, 0, 0, 0, 0, 0]\n");
    let refused = lab.tune(&["--steps", "20"]);
    let text = said(&refused);
    assert_eq!(refused.status.code(), Some(65), "{text}");
    for words in
        ["tune.origin_limit_um is 100", "the laser is displaced", "a PSD is displaced", "--accept-origin"]
    {
        assert!(text.contains(words), "{words}: {text}");
    }
    assert!(lab.untouched() && refused.stdout.is_empty());

    let accepted = lab.tune(&["--steps", "20", "--accept-origin"]);
    assert!(accepted.status.success(), "{}", said(&accepted));
    let config = lab.after();
    assert!(!config.steering.origin_verified);
    let [x, y] = config.steering.origin_um;
    assert!(x.hypot(y) > 200.0, "{x} {y}");
    let systematic = config.estimation.systematic();
    assert!(systematic[..3].iter().any(|sigma| *sigma > 200e-6), "{systematic:?}");
    assert!(systematic[3..].iter().any(|sigma| *sigma > 300e-6), "{systematic:?}");
    let check = lab.command(&["check"]).output().unwrap();
    assert!(String::from_utf8_lossy(&check.stdout).contains("origin_um is not verified"), "{check:?}");

    let text = std::fs::read_to_string(&lab.file).unwrap();
    let mut daemon = Daemon::start(&text);
    daemon.message("steering.origin_um is not verified");
    daemon.message("control socket is open");
    daemon.told(&["reload"]);
    daemon.message("steering.origin_um is not verified");
    let frame = daemon.client().until("a pose", super::testkit::Frame::valid);
    let error = frame.pose[..3].iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    let stated = frame.deviations[..3].iter().fold(0.0_f32, |a, b| a.max(*b));
    assert!(error > 200e-6 && f64::from(stated) > error / 2.0, "{error} m, stated {stated} m");
}
