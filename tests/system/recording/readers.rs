//! Third-party programs read the recordings and find the frames of the stream, bit by bit.

use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;
use std::process::Command;

use trifacet::client::PoseFrame;
use trifacet_wire::Status;

use super::fixture::{Content, Recorder, recordings, same};
use crate::testkit::venv;

const PACKAGES: [&str; 3] = ["mcap==1.6.0", "mcap-ros2-support==0.6.0", "rosbags==0.11.9"];

fn python() -> std::path::PathBuf {
    venv::python("recording-venv", "mcap_ros2, rosbags", &PACKAGES)
}

#[test]
fn mcap_and_rosbags_read_the_frames_and_poses_of_the_stream() {
    std::thread::scope(|scope| {
        for compression in ["lz4", "zstd", "none"] {
            scope.spawn(move || readers_agree(compression));
        }
    });
}

fn readers_agree(compression: &str) {
    let mut daemon = Recorder::start(&format!(
        "acquisition.rate_hz = 500\nrecording.mode = \"always\"\nrecording.compression = \"{compression}\"\n\
         twin.fault = [{{ at_s = 1.0, for_s = 0.2, kind = \"beam-blocked\" }}]"
    ));
    daemon.waits("without light", |frame| frame.status.has(Status::PSD_A_LOW));
    daemon.runs_for(1.5);
    let stream = daemon.stop();
    let files = recordings(&daemon.folder());
    let [file] = files.as_slice() else { panic!("{files:?}") };
    assert_eq!(file.extension().unwrap(), "mcap", "finished at the end");
    let content = Content::read(file);
    assert!(content.whole);
    same(&content.frames(), &stream);
    let read =
        venv::succeeded(Command::new(python()).arg("tests/system/recording/read.py").arg(file), "read.py");
    compare(&String::from_utf8(read.stdout).unwrap(), &content.frames());
}

fn compare(told: &str, recorded: &[PoseFrame]) {
    let by_time: HashMap<i64, &PoseFrame> = recorded.iter().map(|frame| (frame.time_ns, frame)).collect();
    let mut frames: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    let mut poses: BTreeMap<&str, usize> = BTreeMap::new();
    for line in told.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        match words.as_slice() {
            ["frame", reader, hex] => frames.entry(reader).or_default().push(hex),
            ["pose", reader, time, numbers @ ..] => {
                let numbers: Vec<f64> = numbers.iter().map(|x| x.parse().unwrap()).collect();
                pose(by_time[&time.parse::<i64>().unwrap()], &numbers);
                *poses.entry(reader).or_default() += 1;
            }
            other => panic!("{other:?}"),
        }
    }
    let expected: Vec<String> = recorded.iter().map(|frame| hex(&frame.encode()[8..188])).collect();
    let valid = recorded.iter().filter(|frame| frame.status.has(Status::POSE_VALID)).count();
    assert!(valid > 0 && valid < recorded.len());
    for reader in ["mcap", "rosbags"] {
        let mut found = frames[reader].clone();
        // Readers sort messages of equal time differently.
        found.sort_unstable();
        let mut expected: Vec<&str> = expected.iter().map(String::as_str).collect();
        expected.sort_unstable();
        assert!(found == expected, "{reader} reads other frames");
        assert_eq!(poses[reader], valid, "{reader}");
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").unwrap();
        text
    })
}

/// Position bit by bit; orientation and standard uncertainties within the rounding of their representation.
fn pose(frame: &PoseFrame, numbers: &[f64]) {
    let [x, y, z, qx, qy, qz, qw, variances @ ..] = numbers else { panic!("{numbers:?}") };
    assert_eq!([*x, *y, *z], frame.pose[..3]);
    let [roll, pitch, yaw] = [frame.pose[3], frame.pose[4], frame.pose[5]];
    // For small angles, the quaternion contains half of each.
    for (q, angle) in [(qx, roll), (qy, pitch), (qz, yaw)] {
        assert!((q - angle / 2.0).abs() < 1e-6, "{q} {angle}");
    }
    assert!((qw - 1.0).abs() < 1e-6);
    for (variance, deviation) in variances.iter().zip(frame.deviations) {
        let ratio = variance.sqrt() / f64::from(deviation);
        assert!((ratio - 1.0).abs() < 1e-3, "{variance} {deviation}");
    }
}

/// The example of the documentation runs and prints the described output.
#[test]
fn the_example_in_the_documentation_runs() {
    let text = std::fs::read_to_string("docs/recording.md").unwrap();
    let example = text.split("```python\n").nth(1).unwrap().split("```").next().unwrap();
    let mut daemon = Recorder::start("acquisition.rate_hz = 200\nrecording.mode = \"always\"");
    daemon.runs_for(1.0);
    daemon.stop();
    let file = recordings(&daemon.folder()).remove(0);
    let script = example.replace("trifacet-20260102T030405.678Z.mcap", file.to_str().unwrap());
    assert!(script.contains(file.to_str().unwrap()), "{script}");
    let output = venv::succeeded(Command::new(python()).args(["-c", &script]), "the example");
    let text = String::from_utf8(output.stdout).unwrap();
    let valid =
        Content::read(&file).frames().iter().filter(|frame| frame.status.has(Status::POSE_VALID)).count();
    assert_eq!(text.lines().count(), valid, "{text}");
}
