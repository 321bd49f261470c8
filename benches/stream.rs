//! Measures the cost of the stream: latency from acquisition to a client, and CPU time. The daemon is
//! compared with a bare sender of the same datagrams at the same rate:
//! `cargo bench --bench stream [-- SECONDS]`.
//!
//! The two run alternately (daemon, bare, daemon, bare, ...), five pairs for each rate and priority, and
//! the medians are printed. The bare sender sleeps until a sample is due, writes the time into 192 bytes
//! and sends them, which is the minimum for any daemon. The client is the same for both. Priorities require
//! a permission; without it, both run without priority, and the table states this.

use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec, clock_gettime};
use trifacet::config::RealtimeConfig;
use trifacet::realtime;
use trifacet_wire::layout::FRAME_SIZE;

const PAIRS: usize = 5;
const PRIORITY: u8 = 50;
/// Bytes 32 to 39 of a frame: the acquisition time, ns of UTC.
const TIME: std::ops::Range<usize> = 32..40;
const NS: i64 = 1_000_000_000;

fn main() {
    let args: Vec<String> = std::env::args().skip(1).filter(|arg| arg != "--bench").collect();
    match args.first().map(String::as_str) {
        Some("bare") => bare(&args[1], &args[2], &args[3]),
        seconds => compare(seconds.and_then(|s| s.parse().ok()).unwrap_or(5)),
    }
}

/// Sends only the time at which each datagram was due.
fn bare(target: &str, rate: &str, priority: &str) {
    let rate: i64 = rate.parse().expect("a rate");
    let priority = priority.parse().expect("a priority");
    realtime::apply(&RealtimeConfig { priority, ..RealtimeConfig::default() });
    // The same timer slack as the daemon. The default delays by 50 us.
    rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1)).expect("a timer slack");
    rustix::thread::set_name(c"bare").expect("a name");
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
    let start = now(ClockId::Monotonic) + NS / 100;
    let utc = now(ClockId::Realtime) - now(ClockId::Monotonic);
    println!("sending");
    for k in 0.. {
        let due = start + k * NS / rate;
        let wake = Timespec { tv_sec: due / NS, tv_nsec: due % NS };
        clock_nanosleep_absolute(rustix::thread::ClockId::Monotonic, &wake).expect("a sleep");
        let mut frame = [0; FRAME_SIZE];
        frame[TIME].copy_from_slice(&(due + utc).to_le_bytes());
        let _ = socket.send_to(&frame, target); // the receiver may have ended
    }
}

fn now(clock: ClockId) -> i64 {
    let t = clock_gettime(clock);
    t.tv_sec * NS + t.tv_nsec
}

/// Results of one run.
struct Run {
    /// Latency at the 50th, 99th and 99.9th percentile, microseconds.
    latency: [f64; 3],
    /// CPU time, per cent of one core.
    cpu: f64,
    lost: i64,
}

fn compare(seconds: u64) {
    println!("latency acquisition to client in us, median of {PAIRS} interleaved pairs of {seconds} s");
    println!(
        "{:>8} {:>9} {:>7} {:>9} {:>9} {:>9} {:>7} {:>6}",
        "rate Hz", "priority", "", "p50", "p99", "p99.9", "CPU %", "lost"
    );
    for rate in [1000, 10_000] {
        for priority in [0, PRIORITY] {
            let (mut daemons, mut bares) = (Vec::new(), Vec::new());
            for _ in 0..PAIRS {
                daemons.push(measure(rate, seconds, |port| daemon(port, rate, priority)));
                bares.push(measure(rate, seconds, |port| bare_sender(port, rate, priority)));
            }
            let (ours, theirs) = (median(&daemons), median(&bares));
            print(rate, priority, "daemon", &ours);
            print(rate, priority, "bare", &theirs);
            let ratio = |i: usize| ours.latency[i] / theirs.latency[i];
            println!(
                "{:>26} {:>9.2} {:>9.2} {:>9.2} {:>7.2}",
                "ratio",
                ratio(0),
                ratio(1),
                ratio(2),
                ours.cpu / theirs.cpu
            );
        }
    }
}

fn print(rate: i64, priority: u8, who: &str, run: &Run) {
    let [a, b, c] = run.latency;
    println!("{rate:>8} {priority:>9} {who:>7} {a:>9.1} {b:>9.1} {c:>9.1} {:>7.2} {:>6}", run.cpu, run.lost);
}

fn median(runs: &[Run]) -> Run {
    let middle = |f: &dyn Fn(&Run) -> f64| {
        let mut values: Vec<f64> = runs.iter().map(f).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    Run {
        latency: std::array::from_fn(|i| middle(&|run| run.latency[i])),
        cpu: middle(&|run| run.cpu),
        lost: runs.iter().map(|run| run.lost).sum(),
    }
}

fn daemon(port: u16, rate: i64, priority: u8) -> Child {
    let config = std::env::temp_dir().join(format!("trifacet-bench-{}.toml", std::process::id()));
    let text = format!(
        "monitor.listen = \"off\"\n[acquisition]\nrate_hz = {rate}\n[publishing]\ntcp = \"off\"\nudp = [\"127.0.0.1:{port}\"]\n\
         [realtime]\npriority = {priority}\n[log]\nlevel = \"info\"\n"
    );
    std::fs::write(&config, text).expect("a configuration");
    let mut command = Command::new(env!("CARGO_BIN_EXE_trifacet"));
    started(command.args(["run", "--config"]).arg(config).stderr(Stdio::piped()))
}

fn bare_sender(port: u16, rate: i64, priority: u8) -> Child {
    let mut command = Command::new(std::env::current_exe().expect("this program"));
    let target = format!("127.0.0.1:{port}");
    started(command.args(["bare", &target, &rate.to_string(), &priority.to_string()]).stdout(Stdio::piped()))
}

/// Starts a child process and waits for its first line.
fn started(command: &mut Command) -> Child {
    let mut child = command.spawn().expect("a child");
    let mut line = String::new();
    match (child.stdout.take(), child.stderr.take()) {
        (Some(out), _) => BufReader::new(out).read_line(&mut line).expect("a line"),
        (_, Some(err)) => {
            let mut err = BufReader::new(err);
            let n = err.read_line(&mut line).expect("a line");
            std::thread::spawn(move || std::io::copy(&mut err, &mut std::io::sink()));
            n
        }
        _ => 0,
    };
    child
}

fn measure(rate: i64, seconds: u64, start: impl FnOnce(u16) -> Child) -> Run {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
    rustix::net::sockopt::set_socket_recv_buffer_size(&socket, 1 << 20).expect("a buffer");
    socket.set_read_timeout(Some(Duration::from_secs(3))).expect("a time-out");
    let mut child = start(socket.local_addr().expect("an address").port());
    let mut frame = [0; 2 * FRAME_SIZE];
    let mut receive = || {
        socket.recv(&mut frame).expect("a datagram");
        let time = i64::from_le_bytes(frame[TIME].try_into().expect("eight bytes"));
        (time, now(ClockId::Realtime) - time)
    };
    for _ in 0..rate / 2 {
        receive(); // warm-up
    }
    let (first, _) = receive();
    let cpu = cpu_ns(child.id());
    let mut latencies = Vec::new();
    let mut last = first;
    while last - first < seconds as i64 * NS {
        let (time, latency) = receive();
        last = time;
        latencies.push(latency);
    }
    let cpu = (cpu_ns(child.id()) - cpu) as f64 / (last - first) as f64 * 100.0;
    let expected = ((last - first) as f64 * rate as f64 / NS as f64).round() as i64;
    let lost = expected - latencies.len() as i64;
    child.kill().expect("an end");
    child.wait().expect("an end");
    latencies.sort_unstable();
    let at = |part: f64| latencies[((latencies.len() - 1) as f64 * part) as usize] as f64 * 1e-3;
    Run { latency: [at(0.5), at(0.99), at(0.999)], cpu, lost }
}

/// CPU time of all threads of a process until now, nanoseconds.
fn cpu_ns(pid: u32) -> i64 {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).expect("a process");
    let of_thread = |thread: std::io::Result<std::fs::DirEntry>| {
        let text = std::fs::read_to_string(thread.ok()?.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<i64>().ok()
    };
    threads.filter_map(of_thread).sum()
}
