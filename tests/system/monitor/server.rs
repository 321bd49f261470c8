//! Admission to the monitor, and its cost for the other tasks.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};

use super::page::{Metrics, until};
use crate::testkit::http::{Page, ask, get, request};
use crate::testkit::{Daemon, Done, Folder, PATIENCE, Stream, on, wait_for};

const ON: &str = "monitor.listen = \"127.0.0.1:0\"";

/// Runs a command with this configuration.
fn with(command: &str, config: &str) -> Done {
    on(&[command, "--config"], &Folder::new().write("lab.toml", config))
}

#[test]
fn requests_for_other_hosts_and_from_other_sites_are_refused_and_counted() {
    let mut daemon = Daemon::start(&format!("{ON}\nmonitor.allowed_hosts = [\"lab-pc\"]"));
    let at = daemon.monitor();
    let port = at.port();
    for good in
        [format!("localhost:{port}"), format!("127.0.0.1:{port}"), "lab-pc".into(), "LAB-PC:80".into()]
    {
        assert_eq!(ask(at, "/healthz", &format!("Host: {good}\r\n")).code, 200, "{good}");
    }
    let same = format!("Host: {at}\r\nOrigin: http://{at}\r\n");
    assert_eq!(ask(at, "/healthz", &same).code, 200);
    let elsewhere = format!("Host: {at}\r\nOrigin: http://evil.example\r\n");
    for bad in ["Host: evil.example\r\n", "Host: 127.0.0.2\r\n", "", &elsewhere] {
        for path in ["/healthz", "/metrics", "/nothing"] {
            let page = ask(at, path, bad);
            assert_eq!(page.code, 403, "{bad}: {page:?}");
            assert!(page.body.contains(if bad == elsewhere { "Origin" } else { "Host" }), "{page:?}");
        }
    }
    let twice = format!("Host: {at}\r\nHost: evil.example\r\n");
    assert_eq!(ask(at, "/metrics", &twice).code, 400);
    assert_eq!(get(at, "http://evil.example/metrics").code, 403);
    assert_eq!(get(at, &format!("http://{at}/metrics")).code, 200);
    let metrics = Metrics::of(at);
    assert!((metrics.value("trifacet_monitor_forbidden_total", "") - 14.0).abs() < 0.5);
    let page = get(at, "/metrics");
    assert!(!page.headers.contains("access-control-"), "{page:?}");
    assert_eq!(get(at, "/nothing").code, 404);
}

#[test]
fn load_balancers_can_check_the_health() {
    let mut daemon = Daemon::start(ON);
    let at = daemon.monitor();
    until(at, "ready", |ready| ready["ready"] == true);
    // HTTP/1.0 without Host, which no browser sends, for the health only.
    for (path, code) in [("/healthz", 200), ("/readyz", 200), ("/metrics", 403), ("/", 403)] {
        assert_eq!(request(at, &format!("GET {path} HTTP/1.0"), "").code, code, "{path}");
    }
    for bad in ["Host: evil.example\r\n", "Origin: http://evil.example\r\n", "Host: a b\r\n"] {
        assert_eq!(request(at, "GET /healthz HTTP/1.0", bad).code, 403, "{bad}");
    }
    assert_eq!(request(at, "GET http://evil.example/healthz HTTP/1.0", "").code, 403);
    let host = format!("Host: {at}\r\n");
    assert_eq!(request(at, "GET /metrics HTTP/1.0", &host).code, 200);
    for path in ["/healthz", "/readyz", "/metrics", "/"] {
        let [head, get] =
            ["HEAD", "GET"].map(|method| request(at, &format!("{method} {path} HTTP/1.1"), &host));
        assert_eq!((head.code, &head.body[..]), (get.code, ""), "{path}");
        let kind = |page: &Page| {
            page.headers.lines().find(|line| line.starts_with("content-type")).map(str::to_owned)
        };
        assert!(kind(&head).is_some() && kind(&head) == kind(&get), "{head:?}");
    }
}

#[test]
fn a_client_that_closes_its_side_after_the_request_gets_the_answer() {
    let mut daemon = Daemon::start(ON);
    let at = daemon.monitor();
    for _ in 0..50 {
        let mut stream = TcpStream::connect(at).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(b"GET /healthz HTTP/1.0\r\n\r\n").unwrap();
        stream.shutdown(Shutdown::Write).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.0 200") && answer.ends_with("ok\n"), "{answer}");
    }
    // Without a request, the connection ends at once.
    let mut stream = TcpStream::connect(at).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(b"GET /heal").unwrap();
    stream.shutdown(Shutdown::Write).unwrap();
    assert_eq!(stream.read(&mut [0; 100]).unwrap_or(0), 0);
}

#[test]
fn scrapes_and_stalled_viewers_lose_no_sample() {
    let mut daemon =
        Daemon::start(&format!("{ON}\nacquisition.rate_hz = 10000\npublishing.tcp_queue = 65536"));
    let mut stream = Stream::tcp(daemon.address());
    let at = daemon.monitor();
    stream.locked();
    until(at, "ready", |ready| ready["ready"] == true);
    // These clients hold connections and never send a request.
    let hung: Vec<_> = (0..20).map(|_| TcpStream::connect(at).unwrap()).collect();
    let scrapers: Vec<_> = (0..50).map(|_| std::thread::spawn(move || scrape(at))).collect();
    for scraper in scrapers {
        scraper.join().unwrap();
    }
    let heartbeat = stream.heartbeat();
    for counter in ["scans_lost", "estimation_overflows", "tcp_overflows", "tcp_dropped", "monitor_overflows"]
    {
        assert_eq!(heartbeat.counters[counter], 0, "{counter}");
    }
    drop(hung);
}

fn scrape(at: SocketAddr) {
    for _ in 0..5 {
        let page = get(at, "/metrics");
        assert_eq!(page.code, 200);
        assert!(page.body.contains("\ntrifacet_frames_total "));
    }
}

#[test]
fn connections_beyond_the_limit_are_closed_and_the_first_ones_stay() {
    let mut daemon = Daemon::start(ON);
    let at = daemon.monitor();
    let open: Vec<_> = (0..128).map(|_| TcpStream::connect(at).unwrap()).collect();
    let mut one_more = TcpStream::connect(at).unwrap();
    one_more.set_read_timeout(Some(PATIENCE)).unwrap();
    // Closed at once: by an end of the stream or a reset.
    assert_eq!(one_more.read(&mut [0; 1]).unwrap_or(0), 0);
    daemon.message("refused a connection");
    drop(open);
    wait_for("a free connection", || {
        let open = TcpStream::connect(at).is_ok_and(|mut stream| still_open(&mut stream));
        open.then_some(()).ok_or_else(|| "closed".into())
    });
}

/// Whether a connection stays open.
fn still_open(stream: &mut TcpStream) -> bool {
    stream.set_read_timeout(Some(std::time::Duration::from_millis(200))).unwrap();
    stream.read(&mut [0; 1]).is_err_and(|e| e.kind() == std::io::ErrorKind::WouldBlock)
}

#[test]
fn a_port_in_use_is_a_clear_error() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let _holder = TcpListener::bind(taken).unwrap();
    let config = format!("publishing.tcp = \"off\"\npublishing.udp = []\nmonitor.listen = \"{taken}\"\n");
    let done = with("run", &config);
    let errors = done.err;
    assert_eq!(done.code, 75, "{errors}");
    for word in [&taken.to_string(), "monitor.listen", "another process has the port"] {
        assert!(errors.contains(word), "{errors}");
    }
}

#[test]
fn without_monitor_and_tcp_no_port_is_open() {
    let mut daemon = Daemon::start("publishing.tcp = \"off\"\nmonitor.listen = \"off\"");
    daemon.says("locked", |line| line["to"] == "locked");
    let descriptors = std::fs::read_dir(format!("/proc/{}/fd", daemon.pid())).unwrap();
    let sockets: Vec<_> = descriptors
        .filter_map(|entry| std::fs::read_link(entry.unwrap().path()).ok()?.to_str().map(str::to_owned))
        .filter_map(|link| Some(link.strip_prefix("socket:[")?.strip_suffix(']')?.to_owned()))
        .collect();
    for table in ["tcp", "tcp6"] {
        let table = std::fs::read_to_string(format!("/proc/net/{table}")).unwrap();
        for row in table.lines().skip(1) {
            let inode = row.split_whitespace().nth(9).unwrap();
            assert!(!sockets.iter().any(|own| own == inode), "{row}");
        }
    }
    assert!(!daemon.said("monitor is open"));
}

#[test]
fn check_notes_an_address_that_is_open_to_the_network() {
    let note = |config: &str| with("check", config).out;
    let open = note("monitor.listen = \"0.0.0.0:7360\"");
    assert!(open.contains("note") && open.contains("every host that reaches it may read"), "{open}");
    assert!(open.contains("http://0.0.0.0:7360/"), "{open}");
    let closed = note("");
    assert!(closed.contains("http://127.0.0.1:7360/") && !closed.contains("may read"), "{closed}");
    assert!(note("monitor.listen = \"off\"").contains("monitor        off"));
}
