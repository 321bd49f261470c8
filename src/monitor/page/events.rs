//! The events of the last hours, as the page lists them and marks them in its charts. Pure.

use std::collections::VecDeque;

use serde::Serialize;
use trifacet_wire::LockState;

/// Most events kept.
const MOST: usize = 200;
/// An event that repeats one of the last ones within this time is counted with it, milliseconds.
const REPEATS_MS: f64 = 60e3;
/// Number of last events among which a repetition is sought.
const LAST: usize = 8;

/// What an event concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The daemon has started.
    Start,
    /// The grade of the poses.
    Grade,
    /// The lock state.
    Lock,
    /// The tare: poses have another meaning from here.
    Tare,
    /// The configuration.
    Configuration,
    /// The recorder.
    Recording,
    /// TCP clients.
    Clients,
}

/// An event, or equal events in succession.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// Time of the newest one, milliseconds of UTC since 1970.
    pub time_ms: f64,
    /// What it concerns.
    pub kind: Kind,
    /// Description.
    pub text: String,
    /// Number of equal events.
    pub times: u32,
}

/// What is compared with the last time.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// Time, milliseconds of UTC since 1970.
    pub time_ms: f64,
    /// Grade and headline.
    pub grade: (&'static str, String),
    /// The lock state, with its cause.
    pub lock: (LockState, Option<&'static str>),
    /// Configuration id of the frames.
    pub config: u32,
    /// The tare, as its numbers.
    pub tare: Vec<f64>,
    /// The file that is being recorded.
    pub recording: Option<String>,
    /// TCP clients that have come and gone.
    pub clients: [u64; 2],
}

/// The events, oldest first.
#[derive(Debug, Default)]
pub struct Events {
    list: VecDeque<Event>,
    last: Option<Snapshot>,
    changed: bool,
}

impl Events {
    /// Compares with the last call, and adds an event for each difference.
    pub fn look(&mut self, now: Snapshot) {
        let ms = now.time_ms;
        match self.last.take() {
            Some(last) => self.compare(ms, &last, &now),
            None => self.add(ms, Kind::Start, "the monitor of the daemon has started".into()),
        }
        self.last = Some(now);
    }

    fn compare(&mut self, ms: f64, last: &Snapshot, now: &Snapshot) {
        if last.tare != now.tare {
            let cleared = now.tare.iter().all(|x| *x == 0.0);
            self.add(ms, Kind::Tare, if cleared { "tare cleared" } else { "tare set" }.into());
        }
        if last.config != now.config {
            self.add(ms, Kind::Configuration, format!("configuration {:08x} is in force", now.config));
        }
        if last.lock.0 != now.lock.0 {
            let cause = now.lock.1.map_or_else(String::new, |cause| format!(": {cause}"));
            let text = format!("{} after {}{cause}", now.lock.0.name(), last.lock.0.name());
            self.add(ms, Kind::Lock, text);
        }
        if last.grade.0 != now.grade.0 {
            self.add(ms, Kind::Grade, format!("{}: {}", now.grade.0, now.grade.1));
        }
        if last.recording != now.recording {
            let text = match (&now.recording, &last.recording) {
                (Some(file), _) => format!("recording to {file}"),
                (None, file) => format!("recording ended: {}", file.as_deref().unwrap_or("?")),
            };
            self.add(ms, Kind::Recording, text);
        }
        for (i, what) in ["connected", "disconnected"].into_iter().enumerate() {
            for _ in last.clients[i]..now.clients[i].min(last.clients[i] + MOST as u64) {
                self.add(ms, Kind::Clients, format!("a TCP client has {what}"));
            }
        }
    }

    fn add(&mut self, time_ms: f64, kind: Kind, text: String) {
        let recent = self.list.iter().enumerate().rev().take(LAST);
        let same = |event: &Event| {
            event.kind == kind && event.text == text && (time_ms - event.time_ms).abs() < REPEATS_MS
        };
        let before = recent.into_iter().find(|(_, event)| same(event)).map(|(at, _)| at);
        let times = before.and_then(|at| self.list.remove(at)).map_or(0, |event| event.times);
        self.list.push_back(Event { time_ms, kind, text, times: times + 1 });
        if self.list.len() > MOST {
            self.list.pop_front();
        }
        self.changed = true;
    }

    /// All events.
    pub fn list(&self) -> &VecDeque<Event> {
        &self.list
    }

    /// All events, if there are new ones since the last call.
    pub fn news(&mut self) -> Option<Vec<Event>> {
        std::mem::take(&mut self.changed).then(|| self.list.iter().cloned().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn snapshot(s: f64) -> Snapshot {
        Snapshot {
            time_ms: 1e3 * s,
            grade: ("good", "Pose valid, beam locked".into()),
            lock: (LockState::Locked, None),
            config: 1,
            tare: vec![0.0; 6],
            recording: None,
            clients: [0, 0],
        }
    }

    fn texts(events: &Events) -> Vec<(Kind, &str, u32)> {
        events.list().iter().map(|event| (event.kind, event.text.as_str(), event.times)).collect()
    }

    #[test]
    fn each_difference_is_an_event() {
        let mut events = Events::default();
        events.look(snapshot(0.0));
        events.look(snapshot(1.0));
        assert!(events.news().is_some() && events.news().is_none());
        let tared = Snapshot { tare: vec![1.0; 6], config: 2, ..snapshot(2.0) };
        events.look(tared.clone());
        let recording = Some("a.mcap".to_owned());
        events.look(Snapshot { recording, clients: [2, 1], time_ms: 3e3, ..tared.clone() });
        events.look(Snapshot {
            lock: (LockState::Lost, Some("no PSD sees light")),
            grade: ("bad", "No valid pose".into()),
            clients: [2, 1],
            time_ms: 4e3,
            ..tared
        });
        assert_eq!(
            texts(&events),
            [
                (Kind::Start, "the monitor of the daemon has started", 1),
                (Kind::Tare, "tare set", 1),
                (Kind::Configuration, "configuration 00000002 is in force", 1),
                (Kind::Recording, "recording to a.mcap", 1),
                (Kind::Clients, "a TCP client has connected", 2),
                (Kind::Clients, "a TCP client has disconnected", 1),
                (Kind::Lock, "lost after locked: no PSD sees light", 1),
                (Kind::Grade, "bad: No valid pose", 1),
                (Kind::Recording, "recording ended: a.mcap", 1),
            ]
        );
    }

    #[test]
    fn a_state_that_comes_and_goes_fills_two_lines() {
        let mut events = Events::default();
        events.look(snapshot(0.0));
        for n in 1..=100 {
            let lock = if n % 2 == 0 { LockState::Locked } else { LockState::Held };
            events.look(Snapshot { lock: (lock, None), ..snapshot(0.1 * f64::from(n)) });
        }
        assert_eq!(
            texts(&events)[1..],
            [(Kind::Lock, "held after locked", 50), (Kind::Lock, "locked after held", 50)]
        );
        for n in 1..1000 {
            events.look(Snapshot { config: n, ..snapshot(100.0 * f64::from(n)) });
        }
        assert_eq!(events.list().len(), MOST);
    }
}
