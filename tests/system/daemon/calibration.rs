//! The calibration record: whether it belongs to the configuration, and its end while the daemon runs.

use jiff::{SignedDuration, Timestamp};
use serde_json::json;
use trifacet::client::{Client, Descriptor, Endpoint, Message};
use trifacet::config::fingerprint;
use trifacet::config::parse;
use trifacet_wire::Status;

use crate::testkit::{Daemon, Folder, run, trifacet};

/// The fingerprint of a configuration whose paths are absolute.
pub(crate) fn fits(config: &str) -> String {
    let config = parse(config, None).unwrap();
    fingerprint(&config, &config.read_channels().unwrap())
}

/// A record, with more fields than its header.
pub(crate) fn record_of(fits: &str, date: &str, expires: Option<&str>) -> String {
    let mut record = json!({
        "format": 1, "version": "0.1.0", "date": date, "method": "six-axis stage, 500 points", "fits": fits,
        "range_mm": 1.0, "range_mrad": 5.0, "std_um": [0.10, 0.11, 0.08], "std_urad": [0.3, 0.31, 0.2],
        "theta": [1.0, 2.0],
    });
    if let Some(expires) = expires {
        record["expires"] = expires.into();
    }
    record.to_string()
}

const DATE: &str = "2026-05-04T12:00:00Z";
const GEOMETRY: &str = "head.psd_distance_mm = 250.5\n";

/// A configuration with a record of that name in the folder.
fn with_record(folder: &Folder) -> String {
    format!("{GEOMETRY}calibration.record = \"{}\"\n", folder.path("calibration.json").display())
}

fn descriptor(daemon: &mut Daemon) -> Box<Descriptor> {
    let endpoint = Endpoint::Tcp(daemon.address().to_string());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut client = Client::connect(&endpoint).await.unwrap();
        loop {
            if let Message::Descriptor(descriptor) = client.next().await.unwrap() {
                return descriptor;
            }
        }
    })
}

fn check(folder: &Folder, config: &str) -> (i32, String) {
    let file = folder.write("check.toml", config);
    let done = run(trifacet(&["check", "--config"]).arg(file));
    (done.code, done.out + &done.err)
}

#[test]
fn a_record_of_the_configuration_clears_uncalibrated_and_is_named_everywhere() {
    let folder = Folder::new();
    folder.write("calibration.json", record_of(&fits(GEOMETRY), DATE, None));
    let config = with_record(&folder);
    let mut daemon = Daemon::start(&config);
    let line = daemon.message("the head is calibrated");
    assert!(line["record"].as_str().unwrap().contains("six-axis stage, 500 points"), "{line}");
    let frames = daemon.client().take(20);
    assert!(frames.iter().all(|frame| !frame.has(Status::UNCALIBRATED)));
    let descriptor = descriptor(&mut daemon);
    assert!(descriptor.calibrated && descriptor.uncalibrated.is_none());
    let calibration = descriptor.calibration.unwrap();
    assert_eq!((&*calibration.date, &*calibration.method), (DATE, "six-axis stage, 500 points"));
    assert_eq!(calibration.range, [1e-3, 5e-3]);
    assert!((calibration.uncertainty[1] - 0.11e-6).abs() < 1e-18, "{calibration:?}");
    assert_eq!(calibration.expires, None);

    let (code, text) = check(&folder, &config);
    assert_eq!(code, 0, "{text}");
    assert!(
        text.contains("2026-05-04 (") && text.contains("over +-1 mm and +-5 mrad: tx 0.100 ty 0.110"),
        "{text}"
    );
    assert!(!text.contains("UNCALIBRATED"), "{text}");

    let endpoint = format!("tcp://{}", daemon.address());
    let told = run(&mut trifacet(&["doctor", &endpoint]));
    let told = told.out + &told.err;
    assert!(told.contains("calibration of 2026-05-04T12:00:00Z, ") && told.contains("days ago"), "{told}");
}

#[test]
fn a_record_of_another_configuration_is_named_and_the_daemon_runs_uncalibrated() {
    let folder = Folder::new();
    folder.write("calibration.json", record_of(&fits("head.psd_distance_mm = 250.6"), DATE, None));
    let config = with_record(&folder);
    let why = "the calibration record of 2026-05-04 belongs to another configuration: geometry, correction tables, \
               gains or model differ";
    let mut daemon = Daemon::start(&config);
    let line = daemon.message(why);
    assert_eq!(line["level"], "WARN", "{line}");
    assert!(daemon.client().take(20).iter().all(|frame| frame.has(Status::UNCALIBRATED)));
    let descriptor = descriptor(&mut daemon);
    assert_eq!((descriptor.calibrated, descriptor.uncalibrated.as_deref()), (false, Some(why)));
    assert!(descriptor.calibration.is_some());
    let (code, text) = check(&folder, &config);
    assert!(code == 0 && text.contains(&format!("{why}: the frames carry UNCALIBRATED")), "{text}");

    // The right record: a reload takes it over, without a restart.
    folder.write("calibration.json", record_of(&fits(GEOMETRY), DATE, None));
    daemon.signal(rustix::process::Signal::HUP);
    daemon.message("the head is calibrated");
    daemon.client().until("a calibrated frame", |frame| !frame.has(Status::UNCALIBRATED));
}

#[test]
fn a_calibration_that_expires_while_the_daemon_runs_is_noticed() {
    let folder = Folder::new();
    let now = Timestamp::now();
    // Long enough for a slow machine to see calibrated frames first.
    let end = (now + SignedDuration::from_secs(20)).to_string();
    folder.write("calibration.json", record_of(&fits(GEOMETRY), &now.to_string(), Some(&end)));
    let mut daemon = Daemon::start(&with_record(&folder));
    let mut stream = daemon.client();
    assert!(!stream.take(1)[0].has(Status::UNCALIBRATED));
    stream.until("the end of the calibration", |frame| frame.has(Status::UNCALIBRATED));
    assert!(Timestamp::now() >= end.parse().unwrap(), "not before its time");
    let line = daemon.message("has expired");
    assert_eq!(line["level"], "WARN", "{line}");
    let descriptor = descriptor(&mut daemon);
    assert!(descriptor.uncalibrated.unwrap().starts_with("the calibration of "));
    let end: Timestamp = end.parse().unwrap();
    assert_eq!(descriptor.calibration.unwrap().expires.unwrap().parse::<Timestamp>().unwrap(), end);
    // A number of days in the configuration counts as well: half of one after a calibration of yesterday.
    let yesterday = (now - SignedDuration::from_hours(24)).to_string();
    folder.write("calibration.json", record_of(&fits(GEOMETRY), &yesterday, None));
    let (code, text) = check(&folder, &format!("{}calibration.expires_days = 0.5\n", with_record(&folder)));
    assert!(code == 0 && text.contains("has expired: the frames carry UNCALIBRATED"), "{text}");
    let (code, text) = check(&folder, &format!("{}calibration.expires_days = 2\n", with_record(&folder)));
    assert!(code == 0 && !text.contains("UNCALIBRATED") && text.contains("; expires "), "{text}");
}

#[test]
fn a_record_that_cannot_be_used_is_refused_with_its_reason() {
    let folder = Folder::new();
    let config = with_record(&folder);
    let (code, text) = check(&folder, &config);
    assert_eq!(code, 78, "{text}");
    assert!(
        text.contains("calibration.record = ") && text.contains("allowed is a calibration record"),
        "{text}"
    );
    folder.write("calibration.json", "{\"format\": 7, \"version\": \"3.2.1\"}");
    let (code, text) = check(&folder, &config);
    assert!(code == 78 && text.contains("format 7: this version reads format 1"), "{text}");
    folder.write("calibration.json", record_of("00", "yesterday", None));
    let (code, text) = check(&folder, &config);
    assert!(code == 78 && text.contains("date is \"yesterday\": allowed is a time in RFC 3339"), "{text}");
    let (code, text) = check(&folder, "calibration.expires_days = 0");
    assert!(code == 78 && text.contains("calibration.expires_days = 0: allowed is more than 0"), "{text}");
}
