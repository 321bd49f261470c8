//! Clients of a daemon whose frames are rare, because each is the mean of many samples.

use std::process::{Child, Output, Stdio};
use std::time::Duration;

use trifacet::client::{Backoff, Client, Endpoint, Message, Options};

use super::fixture::publishing;
use crate::testkit::{Daemon, Folder, PATIENCE, Udp, trifacet};

/// Samples in a frame, at 1 kHz: more time than any client waits without a reason.
const AVERAGE: u64 = 6000;

fn start(keys: &str) -> Daemon {
    publishing(&format!("tcp = '127.0.0.1:0'\n{keys}\n[estimation]\naverage = {AVERAGE}"))
}

/// An address that is free: its socket has just been closed.
fn free() -> String {
    Udp::open().address().to_string()
}

fn spawn(args: &[&str]) -> Child {
    trifacet(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn succeeds(child: Child) -> (String, String) {
    let Output { status, stdout, stderr } = child.wait_with_output().unwrap();
    let [out, err] = [stdout, stderr].map(|text| String::from_utf8(text).unwrap());
    assert!(status.success(), "{status}: {out}{err}");
    (out, err)
}

#[test]
fn commands_wait_for_the_next_frame() {
    let (watched, checked) = (free(), free());
    let mut daemon = start(&format!("udp = ['{watched}', '{checked}']\nsubscribe = '127.0.0.1:0'"));
    let tcp = daemon.address();
    let config = Folder::new();
    let config = config.write("lab.toml", format!("publishing = {{ tcp = '{tcp}', udp = ['{checked}'] }}\n"));
    // Commands that start after a frame wait for the next one.
    let mut stream = daemon.client();
    stream.take(1);
    let (tcp, subscribe) = (format!("tcp://{tcp}"), format!("subscribe://{}", daemon.subscriptions()));
    let (watched, checked) = (format!("udp://{watched}"), format!("udp://{checked}"));
    let status = spawn(&["status", &tcp, "--socket", "/none"]);
    let two = ["--format", "csv", "--count", "2"];
    let watches = [&watched, &subscribe, &tcp].map(|from| spawn(&[&["watch", from], &two[..]].concat()));
    let doctors =
        [spawn(&["doctor", &tcp]), spawn(&["doctor", &checked, "--config", config.to_str().unwrap()])];
    let (page, note) = succeeds(status);
    assert!(page.contains("pose      valid") && note.contains("a frame comes every 6 s"), "{page}{note}");
    for doctor in doctors {
        let (report, _) = succeeds(doctor);
        assert!(report.contains("poses are valid"), "{report}");
    }
    for (watch, told) in watches.into_iter().zip(["no frame for 3 s", "no frame for 3 s", "every 6 s"]) {
        let (table, note) = succeeds(watch);
        assert_eq!(table.lines().count(), 3, "{table}");
        assert_eq!(note.lines().count(), 1, "one note, not one for each frame: {note}");
        assert!(note.contains(told), "{note}");
    }
    assert_eq!(stream.next().unwrap().averaged, AVERAGE as u16);
}

#[tokio::test]
async fn a_client_keeps_a_link_with_rare_frames() {
    let mut daemon = start("udp = []\nsubscribe = '127.0.0.1:0'");
    // The daemon confirms a long lease less often than it sends frames.
    let options = Options { reconnect: Some(Backoff::default()), lease_s: 60, ..Options::default() };
    let keeps = async |endpoint: Endpoint| {
        let mut client = Client::connect_with(&endpoint, options.clone()).await.unwrap();
        let tcp = matches!(endpoint, Endpoint::Tcp(_));
        let mut frames = 0;
        while frames < 2 {
            let message = tokio::time::timeout(PATIENCE, client.next()).await.expect("a message in time");
            frames += usize::from(matches!(message.unwrap(), Message::Pose(_)));
        }
        assert_eq!(client.reconnects(), 0, "{endpoint}");
        let period = client.frame_period().expect("known after two frames");
        let described = Duration::from_millis(AVERAGE);
        assert!(if tcp { period == described } else { period > described / 2 }, "{period:?}");
    };
    let subscriber = Endpoint::Subscribe(daemon.subscriptions().to_string());
    tokio::join!(keeps(subscriber), keeps(Endpoint::Tcp(daemon.address().to_string())));
}
