//! A viewer: a WebSocket of its own.
//!
//! It says how far back it looks (`{"watch": 60}`, seconds) and gets that past, then every update; or that
//! nobody looks at present (`{"pause": true}`), and gets nothing. One that does not keep up is told how many
//! updates it missed, and asks for the past again: no other viewer notices.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, WebSocketUpgrade, close_code};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::json;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::time::{MissedTickBehavior, interval, timeout};
use trifacet_wire::Status;

use super::own_page;
use crate::monitor::view::View;

/// One that takes nothing for so long is cut off.
const STALL: Duration = Duration::from_secs(10);
/// How often a silent socket is tried: the other side may be gone.
const PING: Duration = Duration::from_secs(20);
/// Most bytes that a viewer may say at a time.
const LONGEST: usize = 256;

/// What a viewer may say.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
enum ViewerRequest {
    /// Updates, and so many seconds of the past.
    Watch(u32),
    /// Nothing for now.
    Pause(bool),
}

/// `GET /live`.
pub async fn open(State(view): State<Arc<View>>, headers: HeaderMap, upgrade: WebSocketUpgrade) -> Response {
    let counters = &view.sources.counters;
    if !own_page(&headers) {
        counters.monitor_forbidden.inc();
        return (StatusCode::FORBIDDEN, "the page of another server may not look\n").into_response();
    }
    let Ok(seat) = Arc::clone(&view.seats).try_acquire_owned() else {
        counters.monitor_refused.inc();
        return (StatusCode::SERVICE_UNAVAILABLE, "all seats are taken\n").into_response();
    };
    upgrade.max_message_size(LONGEST).on_upgrade(async move |socket| {
        // Whatever ends it, is the business of the other side.
        let _ = Viewer { socket, view, updates: None }.serve().await;
        drop(seat);
    })
}

/// Why a socket ends.
struct Gone;

struct Viewer {
    socket: WebSocket,
    view: Arc<View>,
    /// None while nobody looks.
    updates: Option<Receiver<Utf8Bytes>>,
}

impl Viewer {
    async fn serve(mut self) -> Result<(), Gone> {
        let view = Arc::clone(&self.view);
        let mut config = view.sources.config.clone();
        let mut descriptor = view.sources.descriptor.clone();
        let mut pings = interval(PING);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        self.hello().await?;
        loop {
            tokio::select! {
                () = view.ending.cancelled() => return self.bye(close_code::AWAY, "the daemon ends").await,
                said = self.socket.recv() => self.heard(said.ok_or(Gone)?.map_err(|_| Gone)?).await?,
                update = next(self.updates.as_mut()) => self.pass_on(update).await?,
                Ok(()) = config.changed() => self.hello().await?,
                Ok(()) = descriptor.changed() => self.hello().await?,
                _ = pings.tick() => self.send(Message::Ping(<_>::default())).await?,
            }
        }
    }

    async fn send(&mut self, message: Message) -> Result<(), Gone> {
        timeout(STALL, self.socket.send(message)).await.map_err(|_| Gone)?.map_err(|_| Gone)
    }

    async fn say(&mut self, what: &serde_json::Value) -> Result<(), Gone> {
        self.send(Message::Text(what.to_string().into())).await
    }

    async fn bye(&mut self, code: u16, reason: &'static str) -> Result<(), Gone> {
        self.send(Message::Close(Some(CloseFrame { code, reason: reason.into() }))).await
    }

    /// What does not change with every update.
    async fn hello(&mut self) -> Result<(), Gone> {
        let bits = Status::NAMES.iter().zip(Status::MEANINGS);
        let bits: Vec<_> =
            bits.map(|((_, name), context)| json!({ "name": name, "meaning": context })).collect();
        let sources = &self.view.sources;
        let counters: serde_json::Map<_, _> = (sources.counters.list().iter().map(|(name, _)| *name))
            .zip(trifacet_core::telemetry::Counters::MEANINGS)
            .map(|(name, context)| (name.to_owned(), (*context).into()))
            .collect();
        let hello = json!({ "hello": {
            "descriptor": *sources.descriptor.borrow(),
            "config": *sources.config.borrow(),
            "bits": bits,
            "counters": counters,
            "control": sources.control.is_some(),
        }});
        self.say(&hello).await
    }

    async fn heard(&mut self, said: Message) -> Result<(), Gone> {
        let text = match said {
            Message::Text(text) => text,
            Message::Ping(_) | Message::Pong(_) => return Ok(()),
            Message::Binary(_) | Message::Close(_) => return Err(Gone),
        };
        match serde_json::from_str(&text) {
            Ok(ViewerRequest::Watch(span_s)) => {
                // First the seat, then the past: nothing falls between them.
                self.updates.get_or_insert_with(|| self.view.updates());
                let past = json!({ "history": self.view.history(span_s), "span_s": span_s });
                self.say(&past).await
            }
            Ok(ViewerRequest::Pause(true)) => {
                self.updates = None;
                Ok(())
            }
            Ok(ViewerRequest::Pause(false)) | Err(_) => {
                self.bye(close_code::POLICY, "allowed are {\"watch\": seconds} and {\"pause\": true}")
                    .await?;
                Err(Gone)
            }
        }
    }

    async fn pass_on(&mut self, update: Result<Utf8Bytes, RecvError>) -> Result<(), Gone> {
        match update {
            Ok(update) => self.send(Message::Text(update)).await,
            Err(RecvError::Lagged(missed)) => {
                self.view.sources.counters.page_skips.add(missed);
                self.say(&json!({ "missed": missed })).await
            }
            Err(RecvError::Closed) => Err(Gone),
        }
    }
}

/// The next update; never, while nobody looks.
async fn next(updates: Option<&mut Receiver<Utf8Bytes>>) -> Result<Utf8Bytes, RecvError> {
    match updates {
        Some(updates) => updates.recv().await,
        None => std::future::pending().await,
    }
}
