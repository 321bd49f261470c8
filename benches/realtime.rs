//! Runs the release daemon on its real-time twin at 10 kHz for 30 s and measures it from outside:
//! `cargo bench --bench realtime`. The first run has no recording; then one run for each compression follows.
//!
//! Prints losses, latencies and CPU time. The exit code is 1 if a sample is lost on its way to the stream
//! or to the file. A frame can be lost in two places:
//!
//! - before the daemon makes it: its sample is missing (`lost`, or a gap in the sample index);
//! - on its way to this program: only the sequence has a gap, and the network or this program was too slow.

use std::io::Write;
use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::Duration;
use std::{fs, io};

use trifacet::client::PoseFrame;
use trifacet::recording::codec::Decoder;
use trifacet::recording::{Entry, Topic};

const RATE_HZ: f64 = 10_000.0;
const SECONDS: f64 = 30.0;
/// Clock ticks per second in `/proc/*/stat`. Linux uses this value for all programs.
const USER_HZ: f64 = 100.0;

/// A daemon that is killed when the benchmark ends.
struct Daemon(Child);

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn main() -> ExitCode {
    // cargo passes --bench. `cargo test --benches` does not, and should not take 30 s per run.
    if !std::env::args().any(|arg| arg == "--bench") {
        return ExitCode::SUCCESS;
    }
    let runs = [None, Some("none"), Some("lz4"), Some("zstd")].into_iter().map(|record| {
        println!("\nrecording: {}", record.map_or("off".into(), |c| format!("always, compression {c}")));
        measure(record)
    });
    match runs.collect::<io::Result<Vec<bool>>>() {
        Ok(runs) if runs.iter().all(|fine| *fine) => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("realtime: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Runs the daemon, with a recording in this compression. Returns whether no sample was lost.
fn measure(record: Option<&str>) -> io::Result<bool> {
    let socket = UdpSocket::bind("127.0.0.1:0")?;
    rustix::net::sockopt::set_socket_recv_buffer_size(&socket, 1 << 20)?;
    socket.set_read_timeout(Some(Duration::from_secs(5)))?;
    let mut config = tempfile::NamedTempFile::new()?;
    writeln!(config, "acquisition.rate_hz = {RATE_HZ}")?;
    writeln!(config, "monitor.listen = \"off\"")?;
    writeln!(config, "publishing = {{ tcp = \"off\", udp = [\"{}\"] }}", socket.local_addr()?)?;
    let recordings = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR"))?;
    if let Some(compression) = record {
        let folder = recordings.path().display();
        writeln!(
            config,
            "[recording]\nmode = \"always\"\nfolder = \"{folder}\"\ncompression = \"{compression}\""
        )?;
    }
    let mut daemon = Daemon(
        Command::new(env!("CARGO_BIN_EXE_trifacet"))
            .args(["run", "--config"])
            .arg(config.path())
            .stderr(Stdio::null())
            .spawn()?,
    );
    let expected = (RATE_HZ * SECONDS) as u64;
    let mut seen = Arrivals::default();
    while seen.last_index() + 1 < expected {
        let mut bytes = [0; 256];
        let n = socket.recv(&mut bytes)?;
        let frame = PoseFrame::decode(&bytes[..n]).map_err(io::Error::other)?;
        seen.frame(frame);
    }
    let cpu_s = cpu_seconds(daemon.0.id())?;
    seen.report(expected, cpu_s);
    let mut fine = seen.samples_lost == 0 && seen.index_gaps == 0;
    if record.is_some() {
        let recorder_s = thread_seconds(daemon.0.id(), "recorder")? + thread_seconds(daemon.0.id(), "disk")?;
        rustix::process::kill_process(
            rustix::process::Pid::from_child(&daemon.0),
            rustix::process::Signal::TERM,
        )?;
        daemon.0.wait()?;
        fine &= recorded(recordings.path(), recorder_s)?;
    }
    Ok(fine)
}

/// Prints size and cost of the recording. Returns whether it contains all samples.
fn recorded(folder: &Path, cpu_s: f64) -> io::Result<bool> {
    let (mut bytes, mut indices, mut times) = (0, Vec::new(), Vec::new());
    for file in fs::read_dir(folder)? {
        let file = fs::read(file?.path())?;
        bytes += file.len();
        let mut decoder = Decoder::default();
        for message in mcap::MessageStream::new(&file).map_err(io::Error::other)? {
            let message = message.map_err(io::Error::other)?;
            if message.channel.topic == Topic::Sample.name() {
                let entry = decoder.decode(Topic::Sample, &message.data).map_err(io::Error::other)?;
                let Some(Entry::Sample { scan, .. }) = entry else { continue };
                indices.push(scan.index);
                times.push(scan.time);
            }
        }
    }
    indices.sort_unstable();
    let (Some(first), Some(last)) = (indices.first(), indices.last()) else { return Ok(false) };
    let missing = last - first + 1 - indices.len() as u64;
    let seconds =
        times.iter().max().zip(times.iter().min()).map_or(0.0, |(end, begin)| end.seconds_since(*begin));
    let per_s = bytes as f64 / seconds;
    println!(
        "file:    {} samples, {missing} missing; {:.2} MB/s, {:.1} GB/h; recorder {:.1} % of a CPU",
        indices.len(),
        per_s * 1e-6,
        per_s * 3600e-9,
        100.0 * cpu_s / seconds
    );
    Ok(missing == 0)
}

/// Statistics of the received frames.
#[derive(Default)]
struct Arrivals {
    first: Option<PoseFrame>,
    last: Option<PoseFrame>,
    received: u64,
    /// Sum of `lost` in the frames.
    samples_lost: u64,
    /// Missing sample indices that gaps in the sequence do not explain.
    index_gaps: u64,
    /// Frames that were sent but did not arrive here.
    frames_missed: u64,
    invalid: u64,
    solved_ns: Vec<u32>,
    sent_ns: Vec<u32>,
}

impl Arrivals {
    fn last_index(&self) -> u64 {
        self.last.map_or(0, |frame| frame.sample_index)
    }

    fn frame(&mut self, frame: PoseFrame) {
        self.first.get_or_insert(frame);
        if let Some(last) = self.last {
            let missed = frame.sequence.saturating_sub(last.sequence + 1);
            self.frames_missed += missed;
            let samples = frame.sample_index.saturating_sub(last.sample_index);
            self.index_gaps += samples.saturating_sub(missed + 1);
        }
        self.received += 1;
        self.samples_lost += u64::from(frame.lost);
        self.invalid += u64::from(frame.pose[0].is_nan());
        self.solved_ns.push(frame.solve_delay_ns);
        self.sent_ns.push(frame.send_delay_ns);
        self.last = Some(frame);
    }

    fn report(&mut self, expected: u64, cpu_s: f64) {
        let (Some(first), Some(last)) = (self.first, self.last) else { return };
        let seconds = (last.time_ns - first.time_ns) as f64 * 1e-9;
        println!("{RATE_HZ} Hz for {seconds:.3} s by the time stamps");
        println!("samples: {expected} expected, {} received in frames", self.received);
        println!(
            "         {} lost according to the frames, {} missing according to their index",
            self.samples_lost, self.index_gaps
        );
        println!("frames:  {} missed by this receiver, {} without a pose", self.frames_missed, self.invalid);
        for (what, delays) in [("solved", &mut self.solved_ns), ("sent", &mut self.sent_ns)] {
            delays.sort_unstable();
            let at = |part: f64| f64::from(delays[((delays.len() - 1) as f64 * part) as usize]) * 1e-3;
            println!(
                "{what:<7}  after acquisition: p50 {:.1} us, p99 {:.1} us, p99.9 {:.1} us, max {:.1} us",
                at(0.5),
                at(0.99),
                at(0.999),
                at(1.0)
            );
        }
        println!("CPU:     {cpu_s:.2} s, {:.1} % of one", 100.0 * cpu_s / seconds);
    }
}

/// User and system time of a process until now, seconds.
fn cpu_seconds(pid: u32) -> io::Result<f64> {
    seconds_in(&format!("/proc/{pid}/stat"))
}

/// The same for its threads with this name.
fn thread_seconds(pid: u32, name: &str) -> io::Result<f64> {
    let mut seconds = 0.0;
    for thread in fs::read_dir(format!("/proc/{pid}/task"))? {
        let thread = thread?.path();
        if fs::read_to_string(thread.join("comm"))?.trim() == name {
            seconds += seconds_in(&thread.join("stat").display().to_string())?;
        }
    }
    Ok(seconds)
}

fn seconds_in(path: &str) -> io::Result<f64> {
    let stat = fs::read_to_string(path)?;
    // The name in brackets may contain any characters. The times are the 12th and 13th field after it.
    let after = stat.rsplit_once(')').map_or("", |(_, after)| after);
    let ticks = after.split_whitespace().skip(11).take(2).filter_map(|field| field.parse::<f64>().ok());
    Ok(ticks.sum::<f64>() / USER_HZ)
}
