//! SIGHUP and `ctl reload`.

use std::net::SocketAddr;

use rustix::process::Signal;
use serde_json::json;
use trifacet::client::{Client, Endpoint, Message};
use trifacet::exit;

use super::fixture::{AT_REST, Lab};
use crate::testkit::PATIENCE;

#[test]
fn reloadable_keys_change_without_dropping_a_client() {
    let mut daemon = Lab::start(&format!("[centering]\nkp = 0.1\n{AT_REST}"));
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
    let before = daemon.frame();
    daemon.rewrite("kp = 0.1", "kp = 0.2\nlock_limit_um = 5.0");
    daemon.rewrite("[publishing]", "[frames.tool]\ntranslation_mm = [0.0, 0.0, -40.0]\n[publishing]");
    daemon.signal(Signal::HUP);
    let line = daemon.message("control");
    assert_eq!(line["command"], "reload", "{line}");
    let status = daemon.told(&["status"]);
    assert_eq!((&status["loop"]["kp"], &status["loop"]["lock"]), (&json!(0.2), &json!("locked")));
    let after = daemon.frame_with(|frame| frame.config != before.config);
    assert_eq!(after.session, before.session);
    assert!((after.pose[2] + 0.04).abs() < 1e-4, "{after:?}");
    let again = daemon.told(&["reload"]);
    assert_eq!((&again["changed"], &again["refused"]), (&json!([]), &json!([])));
}

#[test]
fn fusion_of_the_steering_can_be_switched_on_without_a_restart() {
    let daemon = Lab::start("[twin]\nmotion = []\n");
    let nine = daemon.frame_with(|frame| !frame.pose[0].is_nan());
    assert!(nine.deviations[0] > 0.9e-6, "{nine:?}");
    daemon.rewrite("# our lab", "# our lab\nestimation.fuse_steering = true\nsteering.deviation_um = 0.1");
    let answer = daemon.told(&["reload"]);
    assert_eq!(answer["changed"], json!(["estimation.fuse_steering", "steering.deviation_um"]));
    let eleven = daemon.frame_with(|frame| frame.config != nine.config && frame.deviations[0] < 0.5e-6);
    assert_eq!(answer["config"], format!("{:08x}", eleven.config));
    // With fusion, the origin of the stage changes the poses, and so the configuration id.
    daemon.rewrite("# our lab", "# our lab\nsteering.origin_um = [0.1, 0.0]");
    assert_eq!(daemon.told(&["reload"])["changed"], json!(["steering.origin_um"]));
    daemon.frame_with(|frame| ![nine.config, eleven.config].contains(&frame.config));
}

#[test]
fn keys_that_need_a_restart_are_refused_by_name_and_the_rest_is_applied() {
    let daemon = Lab::start(AT_REST);
    daemon.rewrite("# our lab", "# our lab\nhead.psd_distance_mm = 300.0\nestimation.balance_limit = 0.2");
    daemon.rewrite("[control]", "tcp_clients = 3\n[control]");
    for changed in [json!(["estimation.balance_limit"]), json!([])] {
        let (code, answer, errors) = daemon.ctl(&["reload"]);
        assert_eq!(code, i32::from(exit::DATA), "{errors}");
        assert_eq!(answer["changed"], changed);
        assert_eq!(answer["refused"], json!(["head.psd_distance_mm", "publishing.tcp_clients"]));
        assert!(errors.contains("head.psd_distance_mm") && errors.contains("need a restart"), "{errors}");
    }
}

#[test]
fn an_invalid_file_changes_nothing() {
    let mut daemon = Lab::start(&format!("[centering]\nkp = 0.1\n{AT_REST}"));
    daemon.rewrite("kp = 0.1", "kp = 0.3\nki_per_s = -5");
    let (code, _, errors) = daemon.ctl(&["reload"]);
    assert_eq!(code, i32::from(exit::CONFIG));
    assert!(errors.contains("daemon.toml:") && errors.contains("centering.ki_per_s = -5"), "{errors}");
    daemon.signal(Signal::HUP);
    let line = daemon.message("configuration unchanged");
    assert_eq!(line["level"], "WARN", "{line}");
    assert_eq!(daemon.told(&["status"])["loop"]["kp"], 0.1);
    std::fs::remove_file(daemon.file()).unwrap();
    let (code, _, errors) = daemon.ctl(&["reload"]);
    assert_eq!(code, i32::from(exit::CONFIG));
    assert!(errors.contains("cannot read"), "{errors}");
}

#[test]
fn a_correction_table_and_dark_offsets_are_read_again() {
    let daemon = Lab::start(AT_REST);
    let before = daemon.frame();
    let table = |d: f64| {
        format!(
            "u_m,v_m,du_m,dv_m\n-0.007,-0.007,{d},0\n0.007,-0.007,{d},0\n-0.007,0.007,{d},0\n0.007,0.007,{d},0\n"
        )
    };
    let file = daemon.home.write("a.csv", table(0.0));
    daemon.rewrite(
        "# our lab",
        "# our lab\nchannels.a.correction = \"a.csv\"\nchannels.b.dark_v = [0.0, 0.0, 0.001]",
    );
    let first = daemon.told(&["reload"]);
    assert_eq!(first["changed"], json!(["channels.a.correction", "channels.b.dark_v"]));
    let frame = daemon.frame_with(|frame| frame.config != before.config);
    assert_eq!(first["config"], format!("{:08x}", frame.config));
    let u_a = f64::from(frame.spots[0]);
    // Only the contents of the table change.
    std::fs::write(&file, table(50e-6)).unwrap();
    let second = daemon.told(&["reload"]);
    assert!(second["changed"][0].as_str().unwrap().contains("correction table"), "{second}");
    let frame = daemon.frame_with(|other| other.config != frame.config && other.config != before.config);
    assert!((f64::from(frame.spots[0]) - u_a - 50e-6).abs() < 12e-6, "{frame:?}");
    std::fs::write(&file, "no table").unwrap();
    let (code, _, errors) = daemon.ctl(&["reload"]);
    assert_eq!(code, i32::from(exit::CONFIG), "{errors}");
    assert_eq!(daemon.told(&["status"])["config"], second["config"]);
}

/// The messages that a TCP client receives until the daemon ends, read on a separate thread.
fn follow(address: SocketAddr) -> std::thread::JoinHandle<(Vec<u32>, u64)> {
    let endpoint = Endpoint::Tcp(address.to_string());
    let (connected, ready) = std::sync::mpsc::channel();
    let thread = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let mut client = Client::connect(&endpoint).await.unwrap();
            let mut configs = Vec::new();
            while let Ok(message) = client.next().await {
                if let Message::Pose(frame) = message {
                    let _ = connected.send(());
                    if configs.last() != Some(&frame.config) {
                        configs.push(frame.config);
                    }
                }
            }
            (configs, client.losses().missed_frames)
        })
    });
    ready.recv_timeout(PATIENCE).unwrap();
    thread
}

#[test]
fn a_reload_drops_no_client_and_no_frame_and_new_clients_get_the_new_descriptor() {
    let mut daemon = Lab::start(AT_REST);
    let client = follow(daemon.tcp);
    let mut ids = vec![daemon.frame().config];
    for z in 1..=10 {
        let from = if z == 1 {
            "[publishing]".to_owned()
        } else {
            format!("base.translation_mm = [0, 0, {}]", z - 1)
        };
        let rest = if z == 1 { "\n[publishing]" } else { "" };
        let section = if z == 1 { "[frames]\n" } else { "" };
        daemon.rewrite(&from, &format!("{section}base.translation_mm = [0, 0, {z}]{rest}"));
        let answer = daemon.told(&["reload"]);
        assert_eq!(answer["changed"], json!(["frames.base.translation_mm"]));
        ids.push(u32::from_str_radix(answer["config"].as_str().unwrap(), 16).unwrap());
        daemon.frame_with(|frame| frame.config == *ids.last().unwrap());
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let descriptor = runtime.block_on(async {
        let mut late = Client::connect(&Endpoint::Tcp(daemon.tcp.to_string())).await.unwrap();
        loop {
            if let Message::Descriptor(descriptor) = late.next().await.unwrap() {
                return descriptor;
            }
        }
    });
    assert_eq!(Some(&descriptor.config), ids.last());
    daemon.end();
    let (configs, missed) = client.join().unwrap();
    assert_eq!((configs, missed), (ids, 0));
}

#[test]
fn the_log_level_changes() {
    let mut daemon = Lab::start(AT_REST);
    daemon.rewrite("format = \"json\"", "format = \"json\"\nlevel = \"warn\"");
    daemon.told(&["reload"]);
    // The new level applies after the message about it.
    let line = daemon.message("configuration: log.level = \"warn\", was ");
    assert_eq!(line["level"], "INFO", "{line}");
    daemon.told(&["gains", "0.1", "100"]); // an info
    daemon.ctl(&["gains", "99", "100"]); // a warning
    let line = daemon.message("control");
    assert_eq!(line["level"], "WARN", "{line}");
}
