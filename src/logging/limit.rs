//! Limits repeated log lines.
//!
//! Lines from one place in the code with the same message, fields aside, are limited to [`BURST`] in
//! [`INTERVAL_S`]. Further lines are counted, and one line at the end of the interval reports their number and the
//! fields of the last one, so that the last change of a state is never lost.
//! Debug and trace lines are not limited.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tracing::callsite::Identifier;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;
use trifacet_core::time::{Clock, Mono, NS_PER_S};

use crate::clock::SystemClock;

/// Largest number of lines per message and interval.
const BURST: u32 = 20;
const INTERVAL_S: i64 = 10;
/// Target of the summary lines, which the filter always admits: without log lines there are no summaries.
pub(super) const ALWAYS: (&str, Level) = ("trifacet::logging", Level::INFO);

/// Number of remembered messages; beyond it, messages with nothing left to summarise are forgotten.
const MOST: usize = 256;

/// A place in the code, and its message.
type Key = (Identifier, String);

/// Recent lines with one message.
#[derive(Debug)]
struct Place {
    began: Mono,
    said: u32,
    held_back: u64,
    /// Fields of the last suppressed line.
    last: String,
    level: Level,
}

/// Suppresses lines. Clones share their state.
#[derive(Clone, Debug)]
pub(super) struct Limiter {
    places: Arc<Mutex<HashMap<Key, Place>>>,
    /// To the thread that writes the summaries: message and time.
    sums: Sender<(Key, Mono)>,
}

impl Limiter {
    /// A limiter with a thread for the summaries; the thread sleeps while no lines are suppressed.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn start() -> std::io::Result<Self> {
        let (limiter, due) = Self::new();
        let summing = limiter.clone();
        std::thread::Builder::new().name("log-sums".into()).spawn(move || {
            for (place, at) in due {
                let ns = u64::try_from(at - SystemClock.now()).unwrap_or(0);
                std::thread::sleep(Duration::from_nanos(ns));
                summing.sum_up(&place);
            }
        })?;
        Ok(limiter)
    }

    fn new() -> (Self, Receiver<(Key, Mono)>) {
        let (sums, due) = mpsc::channel();
        (Self { places: Arc::default(), sums }, due)
    }

    /// Whether this line is written now.
    fn admits(&self, event: &Event<'_>, now: Mono) -> bool {
        let metadata = event.metadata();
        let level = *metadata.level();
        let mut places = self.places.lock().unwrap_or_else(PoisonError::into_inner);
        let over = |place: &Place| now - place.began >= INTERVAL_S * NS_PER_S;
        if places.len() >= MOST {
            places.retain(|_, place| place.held_back > 0 || !over(place));
        }
        let Line { message, fields } = Line::of(event);
        let key = (metadata.callsite(), message);
        let fresh = || Place { began: now, said: 0, held_back: 0, last: String::new(), level };
        let place = places.entry(key.clone()).or_insert_with(fresh);
        if over(place) {
            (place.began, place.said) = (now, 0);
        }
        if place.said < BURST {
            place.said += 1;
            return true;
        }
        place.held_back += 1;
        place.last = fields;
        if place.held_back == 1 {
            // The thread runs as long as the process.
            let _ = self.sums.send((key, place.began + INTERVAL_S * NS_PER_S));
        }
        false
    }

    /// Reports the number of suppressed lines of one message, if there are any.
    fn sum_up(&self, key: &Key) {
        let sum = {
            let mut places = self.places.lock().unwrap_or_else(PoisonError::into_inner);
            places.get_mut(key).map(|place| {
                (std::mem::take(&mut place.held_back), std::mem::take(&mut place.last), place.level)
            })
        };
        let Some((count @ 1.., last, level)) = sum else { return };
        let text = &key.1;
        let last = if last.is_empty() { last } else { format!("; the last: {last}") };
        let line = format!("{text} ... and {count} more in the last {INTERVAL_S} s{last}");
        match level {
            Level::ERROR => tracing::error!(target: "trifacet::logging", count, "{line}"),
            Level::WARN => tracing::warn!(target: "trifacet::logging", count, "{line}"),
            _ => tracing::info!(target: "trifacet::logging", count, "{line}"),
        }
    }

    /// Writes all pending summaries now.
    pub fn sum_up_all(&self) {
        let places: Vec<_> =
            self.places.lock().unwrap_or_else(PoisonError::into_inner).keys().cloned().collect();
        for place in &places {
            self.sum_up(place);
        }
    }
}

impl<S: Subscriber> Layer<S> for Limiter {
    fn event_enabled(&self, event: &Event<'_>, _: Context<'_, S>) -> bool {
        let metadata = event.metadata();
        // Each of the three summary calls is a place of its own, which must not be limited.
        *metadata.level() > Level::INFO
            || metadata.target() == "trifacet::logging"
            || self.admits(event, SystemClock.now())
    }
}

/// Message and fields of an event, separately.
#[derive(Default)]
struct Line {
    message: String,
    /// `name=value`, separated by spaces.
    fields: String,
}

impl Line {
    fn of(event: &Event<'_>) -> Self {
        let mut line = Self::default();
        event.record(&mut line);
        line
    }
}

impl Visit for Line {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        if field.name() == "message" {
            self.message = format!("{value:?}");
        } else {
            let gap = if self.fields.is_empty() { "" } else { " " };
            let _ = write!(self.fields, "{gap}{}={value:?}", field.name()); // writing to a String cannot fail
        }
    }
}

#[cfg(test)]
mod tests {
    use tracing_subscriber::layer::SubscriberExt;
    use tracing_subscriber::util::SubscriberInitExt;

    use super::*;

    /// Collects lines.
    #[derive(Clone, Default)]
    struct Lines(Arc<Mutex<Vec<String>>>);

    impl<S: Subscriber> Layer<S> for Lines {
        fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
            self.0.lock().unwrap().push(Line::of(event).message);
        }
    }

    fn warn_of(what: &str) {
        tracing::warn!("lost: {what}");
    }

    fn change_to(state: &str) {
        tracing::info!(state, number = 3, "lock");
    }

    #[test]
    fn repeated_lines_are_limited_and_counted_and_others_are_not_affected() {
        let lines = Lines::default();
        let (limiter, due) = Limiter::new();
        let _here = tracing_subscriber::registry().with(lines.clone()).with(limiter.clone()).set_default();
        for n in 0..1255 {
            warn_of(if n == 700 { "something else" } else { "light" });
            tracing::debug!("all of these");
        }
        tracing::info!("once");
        let said = || std::mem::take(&mut *lines.0.lock().unwrap());
        let count = |all: &[String], text| all.iter().filter(|line| *line == text).count();
        let first = said();
        assert_eq!(count(&first, "lost: something else"), 1, "same place, another message");
        assert_eq!([count(&first, "lost: light"), count(&first, "once")], [BURST as usize, 1]);
        assert_eq!(count(&first, "all of these"), 1255);
        let (place, at) = due.try_recv().unwrap();
        assert!(at > SystemClock.now() && due.try_recv().is_err(), "one summary, later");
        limiter.sum_up(&place);
        limiter.sum_up_all();
        assert_eq!(said(), ["lost: light ... and 1234 more in the last 10 s"]);
    }

    #[test]
    fn the_summary_has_the_fields_of_the_last_line() {
        let lines = Lines::default();
        let (limiter, _due) = Limiter::new();
        let _here = tracing_subscriber::registry().with(lines.clone()).with(limiter.clone()).set_default();
        (0..BURST).for_each(|_| change_to("held"));
        change_to("lost");
        change_to("found again");
        limiter.sum_up_all();
        let last = lines.0.lock().unwrap().pop().unwrap();
        assert_eq!(last, "lock ... and 2 more in the last 10 s; the last: state=\"found again\" number=3");
    }

    /// Uses a limiter with a clock of its own, and counts admitted lines.
    struct Probe(Limiter, Arc<Mutex<(i64, u32)>>);

    impl<S: Subscriber> Layer<S> for Probe {
        fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
            let (now_s, admitted) = &mut *self.1.lock().unwrap();
            *admitted += u32::from(self.0.admits(event, Mono(*now_s * NS_PER_S)));
        }
    }

    #[test]
    fn the_next_interval_has_lines_again() {
        let (limiter, due) = Limiter::new();
        let state = Arc::default();
        let _here = tracing_subscriber::registry().with(Probe(limiter, Arc::clone(&state))).set_default();
        for (now_s, admitted) in [(0, BURST), (9, BURST), (10, 2 * BURST), (25, 3 * BURST)] {
            state.lock().unwrap().0 = now_s;
            (0..30).for_each(|_| tracing::info!("again"));
            assert_eq!(state.lock().unwrap().1, admitted, "at {now_s} s");
        }
        assert_eq!(due.try_iter().count(), 1, "one pending summary");
    }
}
