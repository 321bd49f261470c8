//! Formats the output of `trifacet status`.

use std::fmt::Write as _;

use serde::Deserialize as _;
use serde_json::Value;
use trifacet::client::PoseFrame;
use trifacet::doubts::ShownDoubt;
use trifacet::grade::{Evidence, Limitation};
use trifacet_core::telemetry::Counters;
use trifacet_wire::{LockState, Status};

use super::Known;

/// Width of a terminal for which rows are wrapped.
const WIDTH: usize = 79;
/// Status bits that are shown elsewhere on the page, or are normal.
const SHOWN_ELSEWHERE: Status =
    Status(Status::POSE_VALID.0 | Status::NOT_LOCKED.0 | Status::STEERING_MEASURED.0);

/// The lines of the page.
pub(super) fn page(source: &str, known: &Known) -> Vec<String> {
    let mut lines = head(source, known);
    lines.extend(replay(known).map(|what| row("replay", &what)));
    let Some(frame) = &known.frame else {
        lines.push(row("pose", "no frame since the last update"));
        lines.extend(source_down(known));
        lines.push(row("losses", &losses(known)));
        lines.extend(receivers(known));
        lines.extend(known.unanswered.as_ref().map(|why| row("control", why)));
        return lines;
    };
    lines.extend(grade(frame, known));
    lines.push(row("pose", &validity(frame, known.between)));
    lines.extend(source_down(known));
    for (i, [length, angle]) in [["tx", "roll"], ["ty", "pitch"], ["tz", "yaw"]].into_iter().enumerate() {
        let [length_um, angle_urad] = [i, i + 3].map(|i| deviated(frame.pose[i], frame.deviations[i]));
        lines.push(format!("{:<9} {length:<5}{length_um} um   {angle:<6}{angle_urad} urad", ""));
    }
    lines.push(row("lock", &lock(frame, known.control.as_ref())));
    lines.extend(cause(frame, known).map(|(since, why)| row("cause", &format!("{why}, since {since}"))));
    let [x, y] = frame.beam_offset.map(|m| number(f64::from(m) * 1e6));
    lines.push(row("offset", &format!("x    {x} um          y     {y} um")));
    lines.push(row("balance", &balance(frame.powers)));
    let [x, y] = frame.steering.map(|m| number(f64::from(m) * 1e6));
    let how = if frame.status.has(Status::STEERING_MEASURED) { "read back" } else { "as commanded" };
    lines.push(row("steering", &format!("x    {x} um          y     {y} um    {how}")));
    lines.extend(commands(known.control.as_ref()));
    lines.extend(known.control.as_ref().and_then(drift).map(|text| row("drift", &text)));
    lines.extend(doubts(known));
    lines.push(row("losses", &losses(known)));
    lines.extend(receivers(known));
    lines.extend(known.unanswered.as_ref().map(|why| row("control", why)));
    lines.push(row("status", &names(Status(frame.status.0 & !SHOWN_ELSEWHERE.0))));
    lines
}

/// The grade of the poses since the last update, and what to do about the most important limitation.
fn grade(frame: &PoseFrame, known: &Known) -> Vec<String> {
    let cause = cause(frame, known).map(|(_, why)| why);
    let source_down = known.control.as_ref().and_then(|control| control["source"]["down"].as_str());
    let evidence = Evidence {
        status: Some(frame.status),
        lately: Status(known.between.0 & !Status::POSE_VALID.0),
        lock: frame.lock,
        lock_cause: cause.as_deref(),
        source_down,
        ..Evidence::default()
    };
    let now = evidence.assess(doubted(known), |_| None);
    let mut lines = wrapped("grade", &format!("{}: {}", now.grade.name(), now.headline));
    let first = now.limitations.first().filter(|first| !first.remedy.is_empty());
    lines.extend(first.into_iter().flat_map(|first| wrapped("remedy", &first.remedy)));
    lines
}

/// A row whose text continues on further lines of at most [`WIDTH`] characters.
fn wrapped(name: &str, text: &str) -> Vec<String> {
    let mut rows: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match rows.last_mut() {
            Some(last) if last.chars().count() + 1 + word.chars().count() <= WIDTH => {
                last.push(' ');
                last.push_str(word);
            }
            last => {
                let first = last.is_none();
                rows.push(row(if first { name } else { "" }, word));
            }
        }
    }
    rows
}

/// Why no samples arrive.
fn source_down(known: &Known) -> Option<String> {
    let why = known.control.as_ref()?["source"]["down"].as_str()?;
    Some(row("source", &format!("down: {why}")))
}

fn row(name: &str, text: &str) -> String {
    format!("{name:<9} {text}").trim_end().to_owned()
}

fn head(source: &str, known: &Known) -> Vec<String> {
    let mut parts = vec![source.to_owned()];
    if let Some(descriptor) = &known.descriptor {
        let (version, config, rate) = (&descriptor.daemon_version, descriptor.config, descriptor.rate_hz);
        parts.push(format!("version {version}  config {config:08x}  {rate} frames/s"));
    }
    let mut rows = vec![row("trifacet", &parts.join("  "))];
    if let Some(control) = &known.control {
        let (pid, uptime) = (&control["pid"], control["uptime_s"].as_f64().unwrap_or(f64::NAN));
        rows.push(row("process", &format!("pid {pid}  up {}", duration(uptime))));
    }
    rows
}

/// What is replayed. Without a descriptor, as over UDP, only the status bits show that it is a replay.
fn replay(known: &Known) -> Option<String> {
    let replay = known.descriptor.as_ref()?.replay.as_ref()?;
    let (file, recorded) = (&replay.file, replay.recorded.get(..19).unwrap_or_default().replace('T', " "));
    let ends = known.heartbeat.as_ref().and_then(|heartbeat| heartbeat.counters.get("replay_ends"));
    let over = !replay.repeat && ends.is_some_and(|n| *n > 0);
    Some(format!("{file}, recorded {recorded} UTC{}", if over { ": ended" } else { "" }))
}

fn duration(seconds: f64) -> String {
    let s = seconds.max(0.0) as u64;
    match s {
        0..60 => format!("{s} s"),
        60..3600 => format!("{} min {} s", s / 60, s % 60),
        3600..86_400 => format!("{} h {} min", s / 3600, s / 60 % 60),
        _ => format!("{} d {} h", s / 86_400, s / 3600 % 24),
    }
}

fn validity(frame: &PoseFrame, between: Status) -> String {
    if !frame.status.has(Status::POSE_VALID) {
        let reasons = Status(frame.status.0 & Status::FATAL.0);
        return format!(
            "NOT VALID: {}",
            if reasons.0 == 0 { "samples are missing".into() } else { names(reasons) }
        );
    }
    match Status(between.0 & Status::FATAL.0) {
        Status(0) => "valid".into(),
        before => format!("valid; just before: {}", names(before)),
    }
}

fn lock(frame: &PoseFrame, control: Option<&Value>) -> String {
    if frame.status.has(Status::REPLAYED) {
        return format!("{}   replayed: no steering", frame.lock.name());
    }
    let control_loop = control.map(|control| &control["loop"]);
    let mode = control_loop
        .and_then(|control_loop| control_loop["mode"].as_str())
        .map(|mode| format!("   loop {mode}"));
    let failed =
        control_loop.and_then(|control_loop| control_loop["searches_in_vain"].as_u64()).filter(|n| *n > 0);
    let failed = failed.map(|n| format!("   {n} failed searches"));
    [frame.lock.name(), &mode.unwrap_or_default(), &failed.unwrap_or_default()].concat()
}

/// Time of the last change of the lock state and its cause, if they belong to the lock state of the frame:
/// from the control socket, or otherwise from the last heartbeat.
fn cause(frame: &PoseFrame, known: &Known) -> Option<(String, String)> {
    let lock = frame.lock.name();
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let control = known.control.as_ref().map(|control| &control["loop"]).filter(|now| now["lock"] == lock);
    let heartbeat = known.heartbeat.as_ref().and_then(|heartbeat| heartbeat.lock.as_ref());
    let heartbeat = heartbeat.filter(|event| event.lock == lock);
    control
        .and_then(|now| Some((text(&now["lock_since"])?, text(&now["cause_text"])?)))
        .or_else(|| heartbeat.map(|event| (event.since.clone(), event.text.clone())))
        .map(|(since, why)| (since.get(..19).unwrap_or(&since).replace('T', " ") + " UTC", why))
}

/// The share of each PSD, and the total power.
fn balance(powers: [f32; 3]) -> String {
    let powers = powers.map(f64::from);
    let sum: f64 = powers.iter().sum();
    let share = |power: f64| {
        let share = power / sum * 100.0;
        if share.is_finite() { format!("{share:>6.2} %") } else { format!("{:>8}", "-") }
    };
    let [a, b, c] = powers.map(share);
    let all = if sum.is_finite() { format!("{:.4} mW", sum * 1e3) } else { "-".into() };
    format!("A {a}   B {b}   C {c}   of {all}")
}

fn losses(known: &Known) -> String {
    let Some(heartbeat) = &known.heartbeat else { return "not available on this link".into() };
    let counted = |name: &str| heartbeat.counters.get(name).copied().filter(|n| *n > 0);
    let mut losses: Vec<_> =
        Counters::losses().filter_map(|name| Some(format!("{name} {}", counted(name)?))).collect();
    if known.missing > 0 {
        losses.push(format!("missing here {}", known.missing));
    }
    if losses.is_empty() { "none".into() } else { losses.join("  ") }
}

/// The commands that the stage does not answer in time. Only the control socket tells them.
fn commands(control: Option<&Value>) -> Option<String> {
    let commands = control.map(|control| &control["loop"]["commands"])?;
    let (count, age_s) = (commands["unanswered"].as_u64()?, commands["age_s"].as_f64()?);
    let overdue = commands["overdue"].as_bool()? && count > 0;
    overdue.then(|| {
        row(
            "commands",
            &format!("{count} unanswered, the oldest for {age_s:.3} s: the stage does not answer"),
        )
    })
}

/// The drift since the calibration, from the answer of the control socket; `None` while it is not known.
pub(crate) fn drift(control: &Value) -> Option<String> {
    let drift = &control["calibration_drift"];
    let number = |key: &str, i: usize| drift[key][i].as_f64();
    let (x, y) = (number("residual_um", 0)?, number("residual_um", 1)?);
    let mut text = format!("x {x:.3} y {y:.3} um of {:.3} um", drift["limit_um"].as_f64()?);
    if let (Some(b), Some(c)) = (number("power_gains_percent", 0), number("power_gains_percent", 1)) {
        let _ = write!(text, "   gains B {b:+.2} % C {c:+.2} %");
    }
    if let [Some(a), Some(b), Some(c)] = [0, 1, 2].map(|i| number("dark_percent", i)) {
        let _ = write!(text, "   dark A {a:+.2} % B {b:+.2} % C {c:+.2} %");
    }
    Some(text)
}

/// The doubts that stand. Only the control socket tells them.
fn doubts(known: &Known) -> Vec<String> {
    let shown = |doubt: Limitation| {
        wrapped("doubt", &format!("since {}: {}", doubt.since.unwrap_or_default(), doubt.text))
    };
    doubted(known).into_iter().flat_map(shown).collect()
}

/// The doubts that the control socket reports.
fn doubted(known: &Known) -> Vec<Limitation> {
    let all = known.control.as_ref().map(|control| &control["doubts"]);
    let doubts = all.and_then(|all| Vec::<ShownDoubt>::deserialize(all).ok());
    doubts.iter().flatten().map(ShownDoubt::limitation).collect()
}

/// The receivers of datagrams that fail. Only the control socket tells them.
fn receivers(known: &Known) -> Vec<String> {
    let all = known.control.as_ref().and_then(|control| control["receivers"].as_array());
    let failing = |receiver: &Value| {
        let (name, failing) = (receiver["receiver"].as_str()?, &receiver["failing"]);
        let (since, cause) = (failing["since"].as_str()?, failing["cause"].as_str()?);
        Some(row("receiver", &format!("{name} fails since {since}: {cause}")))
    };
    all.into_iter().flatten().filter_map(failing).collect()
}

fn names(status: Status) -> String {
    status.names().collect::<Vec<_>>().join(" ")
}

/// Formats a number in at least twelve characters.
fn number(x: f64) -> String {
    if x.is_nan() { format!("{:>12}", "-") } else { format!("{x:>12.3}") }
}

fn deviated(x: f64, deviation: f32) -> String {
    let deviation = f64::from(deviation) * 1e6;
    let deviation = if deviation.is_finite() { format!("{deviation:.3}") } else { "-".into() };
    format!("{} +- {deviation:<8}", number(x * 1e6))
}

/// The header of the lines of [`line`].
pub(super) fn header() -> String {
    let names = ["tx um", "ty um", "tz um", "roll urad", "pitch urad", "yaw urad", "off x um", "off y um"];
    let names: Vec<_> = names.iter().map(|name| format!("{name:>12}")).collect();
    format!("# {:<9} {:<9} {} {:>8}  trouble", "lock", "pose", names.join(" "), "frames")
}

/// The state in one line.
pub(super) fn line(known: &Known) -> String {
    let Some(frame) = &known.frame else {
        return format!("  {:<9} {:<9} no frame since the last line", "-", "-");
    };
    let valid = if frame.status.has(Status::POSE_VALID) { "valid" } else { "NOT VALID" };
    let offset = frame.beam_offset.map(f64::from);
    let numbers: Vec<_> = frame.pose.iter().chain(&offset).map(|x| number(x * 1e6)).collect();
    let mut trouble = names(Status(known.between.0 & Status::FATAL.0));
    if let Some((_, why)) = cause(frame, known).filter(|_| frame.lock != LockState::Locked) {
        let gap = if trouble.is_empty() { "" } else { "  " };
        trouble = format!("{trouble}{gap}{why}");
    }
    let line =
        format!("  {:<9} {valid:<9} {} {:>8}  {trouble}", frame.lock.name(), numbers.join(" "), known.frames);
    line.trim_end().to_owned()
}

/// The colour of a line, as an SGR number. `None`: neutral.
pub(super) fn mood(line: &str) -> Option<&'static str> {
    let (name, text) = line.split_once(' ')?;
    let text = text.trim_start();
    let is = |state: LockState| text.split(' ').next() == Some(state.name());
    Some(match name {
        "grade" if text.starts_with("good") => "32",
        "grade" if text.starts_with("limited") => "33",
        "pose" if text == "valid" => return None,
        "pose" if text.starts_with("valid") => "33",
        "grade" | "pose" | "commands" => "31",
        "lock" if is(LockState::Locked) => return None,
        "lock" if is(LockState::Lost) || is(LockState::Railed) => "31",
        "lock" | "cause" | "doubt" | "control" | "replay" | "receiver" => "33",
        "losses" if text != "none" => "33",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use trifacet::client::Heartbeat;

    use super::*;

    fn frame() -> PoseFrame {
        PoseFrame {
            session: 1,
            config: 2,
            sequence: 3,
            sample_index: 4,
            time_ns: 5,
            solve_delay_ns: 6,
            send_delay_ns: 7,
            status: Status::POSE_VALID | Status::UNCALIBRATED | Status::STEERING_MEASURED,
            clock_quality: 8,
            lock: LockState::Locked,
            iterations: 2,
            pose: [1.234_567e-6, -0.1, 12.345_678_9, 3.1, -2e-9, f64::NAN],
            systematic: None,
            deviations: [1e-7, 2e-3, f32::INFINITY, f32::NAN, 1e-9, 1e-6],
            beam_offset: [0.5e-6, -1.25e-6],
            steering_residual: 0.0,
            averaged: 1,
            lost: 0,
            spots: [0.0; 6],
            powers: [1e-4, 2e-4, 1e-4],
            steering: [1e-4, f32::NAN],
        }
    }

    #[test]
    fn columns_are_aligned_also_with_long_numbers() {
        let known = Known { frame: Some(frame()), ..Known::default() };
        let page = page("tcp://here:1", &known);
        let first = page.iter().position(|line| line.starts_with("pose")).unwrap() + 1;
        let lengths: Vec<_> =
            page[first..first + 3].iter().map(|line| line.find(" um   ").unwrap()).collect();
        assert_eq!(lengths, [lengths[0]; 3], "{page:#?}");
        assert!(
            page[first + 2].contains("12345678.900 +- - ") && page[first + 2].ends_with("- +- 1.000    urad"),
            "{page:#?}"
        );
        let widest = page.iter().map(|line| line.chars().count()).max().unwrap();
        assert!(widest <= 80, "{widest} {page:#?}");
        assert_eq!(page[first + 5], "balance   A  25.00 %   B  50.00 %   C  25.00 %   of 0.4000 mW");
        let (header, line) = (header(), line(&known));
        assert_eq!(header.find(" off y um").map(|at| at + 9), line.find("-1.250").map(|at| at + 6));
    }

    #[test]
    fn faults_are_shown_with_their_reason() {
        let mut known = Known { frame: Some(frame()), ..Known::default() };
        known.between = Status::POWER_STEP;
        let counters = [("scans_lost".to_owned(), 7), ("scans".to_owned(), 9)].into();
        known.heartbeat = Some(Heartbeat { counters, ..Heartbeat::default() });
        let text = page("", &known).join("\n");
        assert!(text.contains("pose      valid; just before: POWER_STEP"), "{text}");
        assert!(text.contains("losses    scans_lost 7\n"), "{text}");
        let status = Status::PSD_B_LOW | Status::NOT_LOCKED;
        let dark = PoseFrame { status, lock: LockState::Lost, powers: [f32::NAN; 3], ..frame() };
        known.frame = Some(dark);
        let text = page("", &known).join("\n");
        assert!(
            text.contains("pose      NOT VALID: PSD_B_LOW\n") && text.contains("lock      lost\n"),
            "{text}"
        );
        assert!(line(&known).ends_with("POWER_STEP") && line(&known).contains("NOT VALID"));
        known.frame = None;
        assert!(line(&known).contains("no frame") && page("", &known)[1].contains("no frame"));
        assert_eq!(
            ["grade     good: Pose valid", "pose      valid", "lock      lost", "losses    none"].map(mood),
            [Some("32"), None, Some("31"), None]
        );
    }
}
